"""Parametric bodies with a known truth: where the bust point and the wire's ends are, whatever the body is like.

Bodies come from the package `anny` (the extra `bodies`), whose shape data are CC0 and whose mesh always has the same
vertices. Marks are places on that mesh, so that they go with every size, age and pose. They were carried over from the
landmark files of twelve such bodies, whose marks were made without brafit. Leaving each of the twelve out, its marks
are met by the others' within 2 mm (bust point), 4 mm (inner end) and 11 mm (outer end) in the median, 4, 9 and 24 mm
at most.

Frame: x to the wearer's left, y up, z to the front, mm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse.linalg import spsolve
from scipy.spatial.transform import Rotation

from brafit.cloud.open3d_runtime import open3d
from brafit.errors import BrafitError
from brafit.landmarks.file import SIDES

MIDDLING = {
    "gender": 1.0, "age": 0.7, "weight": 0.5, "height": 0.5, "muscle": 0.5, "proportions": 0.5, "cupsize": 0.5,
    "firmness": 0.5,
}  # fmt: skip
"""The body on which marks are kept."""
RANGES = {
    "age": (0.6, 0.95),
    "weight": (0.3, 0.75),
    "height": (0.3, 0.7),
    "muscle": (0.4, 0.6),
    "proportions": (0.4, 0.7),
    "cupsize": (0.3, 0.95),
    "firmness": (0.3, 0.9),
}
"""Where the shape parameters of adult women are drawn from."""
LOCAL = {
    "breast-dist-incr": (-0.4, 0.5),
    "breast-trans-up": (-0.3, 0.2),
    "breast-volume-vert-up": (-0.4, 0.1),
    "torso-scale-horiz-incr": (-0.2, 0.1),
    "torso-scale-depth-incr": (-0.1, 0.16),
}
"""Where changes of the breasts and of the trunk are drawn from; anny's names."""
PREGNANT = "stomach-pregnant-incr"
RING = np.arange(8418, 8434)
"""Vertices round the left nipple: the bust point is their middle."""
INNER = np.array([[16.4, 391.1, 209.8], [20.6, -28.1, 5.9], [4.4, -2.9, 1.0], [-0.3, 7.0, -0.3], [-4.2, -19.6, 2.1]])
"""The left wire's inner end on the middling body: a constant, and what cup size, weight, firmness and age add."""
OUTER = np.array([
    [120, 316, 181], [122, 324, 179], [126, 332, 173], [132, 340, 166], [136, 348, 161], [139, 356, 158],
    [141, 364, 156], [143, 372, 154], [143, 380, 154], [143, 388, 154],
])  # fmt: skip
OUTER_CUP, CUP = np.array([-0.9, 0.0, -16.0]), 0.67
"""Along the outer side of the left breast on the middling body, and what cup size over CUP adds: the outer end is on
it, where it is higher than the inner one by TILT of the distance between the two."""
TILT = 0.05
BREAST = 1.0
"""A vertex that the cup size moves farther (mm) is on a breast."""
TORSO, HALF_WIDTH = (0.58, 0.88), 260.0
"""The part of the body's height, and the distance from the midline (mm), that a torso has."""
CHEST, CHEST_WIDTH, BEHIND = (0.64, 0.84), 190.0, -20.0
"""The same of a chest that is cut off behind, and how far before (mm) the middle of its depth it is cut."""
POSES: dict[str, dict[str, tuple[str, float]]] = {
    "rest": {},
    "hanging": {"upperarm01": ("out", -30.0)},
    "raised": {"upperarm01": ("out", 70.0), "shoulder01": ("out", 25.0)},
    "bent": {"spine05": ("forward", 20.0), "spine04": ("forward", 15.0), "spine03": ("forward", 10.0)},
    "prone": {"spine05": ("forward", 40.0), "spine04": ("forward", 30.0), "spine03": ("forward", 20.0)},
}
"""Turns of bones from the pose that the model is made in (arms half way out), degrees."""

Marks = dict[str, Float[np.ndarray, "3"]]


@dataclass(frozen=True)
class Kind:
    """A kind of body.

    Attributes:
        ranges: shape parameters that are drawn from elsewhere than RANGES.
        pose: one of POSES.
        keep: `torso`, `whole`, or `chest` (cut off behind, as the chest of somebody lying face down).
        pregnant: how much.
        other: what is left of one of the breasts, by chance the left or the right one; 0: a flat chest.
        hang: how far (mm) the breasts sink downwards.
        front: cameras in front only.
    """

    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    pose: str = "rest"
    keep: str = "torso"
    pregnant: tuple[float, float] = (0.0, 0.0)
    other: float = 1.0
    hang: tuple[float, float] = (0.0, 0.0)
    front: bool = False


SMALL = {"cupsize": (0.12, 0.3)}
LARGE = {"cupsize": (0.9, 1.0), "firmness": (0.0, 0.6), "weight": (0.5, 1.0)}
OLD = {"age": (0.95, 1.0), "firmness": (0.0, 0.3)}
KINDS = {
    "plain": Kind(),
    "small": Kind(SMALL),
    "very small": Kind({"cupsize": (0.0, 0.1)}),
    "large": Kind(LARGE),
    "old": Kind(OLD),
    "one missing": Kind(other=0.0),
    "one half the size": Kind(other=0.5),
    "whole": Kind(keep="whole"),
    "whole, arms hanging": Kind(keep="whole", pose="hanging"),
    "whole, arms raised": Kind(keep="whole", pose="raised"),
    "whole, one missing": Kind(keep="whole", other=0.0),
    "arms hanging": Kind(pose="hanging"),
    "arms raised": Kind(pose="raised"),
    "front only": Kind(front=True),
    "whole, front only": Kind(keep="whole", front=True),
    "bent forward": Kind(pose="bent", hang=(5.0, 20.0)),
    "prone, cut off behind": Kind({"cupsize": (0.6, 1.0)}, pose="prone", keep="chest", hang=(20.0, 45.0)),
    "pregnant": Kind(pregnant=(0.5, 1.0)),
    "whole, pregnant": Kind(keep="whole", pregnant=(0.5, 1.0)),
    "men": Kind({"gender": (0.0, 0.0)}),
}
"""Kinds of body; `plain` are standing women's torsos."""


@dataclass(frozen=True, eq=False)
class Body:
    """A body's surface and marks.

    Attributes:
        vertices, faces: the surface that a scanner sees.
        marks: `apex`, `inner_end` and `outer_end` of each breast, by its side; None where there is no breast.
        parameters: of the model.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    marks: dict[str, Marks | None]
    parameters: dict[str, float]


class Bodies:
    """The model of bodies.

    Raises:
        BrafitError: anny is not installed.
    """

    def __init__(self):
        self._model = _model()
        self.faces: Int[np.ndarray, "f 3"] = self._model.faces.cpu().numpy()
        self._middling = self.vertices(MIDDLING)
        self._mirrored = np.array([-1.0, 1.0, 1.0])
        moved = self.vertices(MIDDLING | {"cupsize": 1.0}) - self.vertices(MIDDLING | {"cupsize": 0.0})
        self.breasts: Bool[np.ndarray, " v"] = np.linalg.norm(moved, axis=1) > BREAST
        self._weight = np.clip(np.linalg.norm(moved, axis=1) / np.linalg.norm(moved, axis=1).max() / 0.6, 0, 1)

    def vertices(
        self, shape: Mapping[str, float], local: Mapping[str, float] | None = None, pose: str = "rest"
    ) -> Float[np.ndarray, "v 3"]:
        """All vertices of a body (mm)."""
        import torch

        with torch.no_grad():
            found = self._model(
                self._turns(pose) if POSES[pose] else None,
                phenotype_kwargs=dict(shape),
                local_changes_kwargs=dict(local or {}),
                pose_parameterization="local-ref",
            )
        body = found["vertices"][0].double().cpu().numpy()
        # anny has metres, z up and y to the back.
        return 1000.0 * np.stack([body[:, 0], body[:, 2], -body[:, 1]], axis=1)

    def _turns(self, pose: str) -> dict[str, Any]:
        import torch

        labels, turns = self._model.bone_labels, {}
        for bone, (way, degrees) in POSES[pose].items():
            for label, sign in ((f"{bone}.L", 1.0), (f"{bone}.R", -1.0), (bone, 1.0)):
                if label in labels:
                    axis = [0.0, -sign, 0.0] if way == "out" else [1.0, 0.0, 0.0]
                    turn = np.eye(4)
                    turn[:3, :3] = Rotation.from_rotvec(np.radians(degrees) * np.array(axis)).as_matrix()
                    turns[label] = torch.as_tensor(turn, dtype=self._model.dtype)[None]
        return turns

    def body(self, kind: Kind, random: np.random.Generator) -> Body:
        """A body of a kind, drawn by chance."""
        shape = {"gender": 1.0} | {key: _drawn(random, limits) for key, limits in {**RANGES, **kind.ranges}.items()}
        local = {key: _drawn(random, limits) for key, limits in LOCAL.items()}
        local[PREGNANT] = _drawn(random, kind.pregnant)
        hang, less = _drawn(random, kind.hang), SIDES[int(random.integers(2))]
        rest, posed = self.vertices(shape, local), self.vertices(shape, local, kind.pose)
        places = self._places(rest, shape)
        if kind.other < 1:
            there = self.breasts & ((rest[:, 0] > 0) == (less == "left"))
            posed = levelled(posed, self.faces, there, kind.other)
        posed = posed - hang * self._weight[:, None] * np.array([0.0, 1.0, 0.0])
        marks: dict[str, Marks | None] = {
            side: {name: weights @ posed for name, weights in found.items()} for side, found in places.items()
        }
        if kind.other == 0:
            marks[less] = None
        if shape["gender"] < 0.5:
            marks = dict.fromkeys(SIDES)
        parameters = shape | local | {"hang": hang, "other": kind.other}
        vertices, faces = smooth(posed, self.faces[self._kept(rest, kind.keep)])
        return Body(vertices, faces, settled_marks(marks, vertices, faces), parameters)

    def _kept(self, rest: np.ndarray, keep: str) -> Bool[np.ndarray, " f"]:
        """The faces of a part of the body."""
        height = rest[:, 1]
        share = (height - height.min()) / (height.max() - height.min())
        kept = np.ones(len(rest), dtype=bool)
        if keep == "torso":
            kept = (share > TORSO[0]) & (share < TORSO[1]) & (np.abs(rest[:, 0]) < HALF_WIDTH)
        elif keep == "chest":
            kept = (share > CHEST[0]) & (share < CHEST[1]) & (np.abs(rest[:, 0]) < CHEST_WIDTH)
            middle = (rest[kept, 2].min() + rest[kept, 2].max()) / 2
            kept &= rest[:, 2] > middle + BEHIND
        return np.asarray(kept[self.faces].all(axis=1))

    def _places(self, rest: np.ndarray, shape: Mapping[str, float]) -> dict[str, dict[str, np.ndarray]]:
        """The marks of both sides as weights of the vertices."""
        given = np.array([1.0, *(shape[key] for key in ("cupsize", "weight", "firmness", "age"))])
        found = {}
        for side, mirror in zip(SIDES, (np.ones(3), self._mirrored), strict=True):
            line = OUTER + (shape["cupsize"] - CUP) * OUTER_CUP
            inner, *outer = self._weights(np.concatenate([(given @ INNER)[None], line]) * mirror)
            ends = np.stack([weights @ rest for weights in outer])
            away = ends - inner @ rest
            high = away[:, 1] >= TILT * np.linalg.norm(away, axis=1)
            ring = self._weights(self._middling[RING] * mirror)
            last = int(high.argmax()) if high.any() else -1
            found[side] = {"apex": np.mean(ring, axis=0), "inner_end": inner, "outer_end": outer[last]}
        return found

    def _weights(self, places: Float[np.ndarray, "n 3"]) -> list[Float[np.ndarray, " v"]]:
        """Places on the middling body as weights of its vertices."""
        triangles, shares, _ = _nearest(self._middling, self.faces, places)
        weights = np.zeros((len(places), len(self._middling)))
        for row, (face, share) in enumerate(zip(triangles, shares, strict=True)):
            weights[row, self.faces[face]] = share
        return list(weights)


def levelled(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], there: Bool[np.ndarray, " v"], left: float
) -> Float[np.ndarray, "v 3"]:
    """The body with what is raised at some vertices brought down to the surface that a membrane would make.

    Args:
        vertices: of the body, mm.
        faces: corners of its triangles.
        there: the vertices that move.
        left: what share of the height is left, 0 to 1.
    """
    n = len(vertices)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    links = sparse.coo_array((np.ones(len(edges)), edges.T), shape=(n, n)).tocsr()
    links = ((links + links.T) > 0).astype(float)
    laplacian = (sparse.diags_array(links.sum(axis=1)) - links).tocsr()
    free, held = np.flatnonzero(there), np.flatnonzero(~there)
    right = -(laplacian[free][:, held] @ vertices[held])
    level = vertices.copy()
    level[free] = spsolve(laplacian[free][:, free].tocsc(), right)
    return level + left * (vertices - level)


def smooth(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> tuple[Float[np.ndarray, "w 3"], Int[np.ndarray, "g 3"]]:
    """The part of a mesh that its faces use, as a smooth surface: Loop's subdivision, once."""
    from trimesh.remesh import subdivide_loop

    used, index = np.unique(faces, return_inverse=True)
    return subdivide_loop(vertices[used], index.reshape(-1, 3), iterations=1)


def settled_marks(
    marks: Mapping[str, Marks | None], vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> dict[str, Marks | None]:
    """Marks moved to the nearest places of a surface."""
    return {
        side: named and {name: _nearest(vertices, faces, place[None])[2][0] for name, place in named.items()}
        for side, named in marks.items()
    }


def _drawn(random: np.random.Generator, limits: tuple[float, float]) -> float:
    return float(random.uniform(*limits))


def _nearest(vertices: np.ndarray, faces: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The nearest places on a mesh: triangle, shares of its corners, place."""
    o3d = open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(np.ascontiguousarray(vertices, dtype=np.float32)),
        o3d.core.Tensor(np.ascontiguousarray(faces, dtype=np.uint32)),
    )
    found = scene.compute_closest_points(o3d.core.Tensor(np.ascontiguousarray(places, dtype=np.float32)))
    u, v = found["primitive_uvs"].numpy().astype(float).T
    return found["primitive_ids"].numpy(), np.stack([1 - u - v, u, v], axis=1), found["points"].numpy().astype(float)


def _model() -> Any:
    try:
        import anny  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError:
        raise BrafitError("anny, which makes the bodies, is missing. Run: pip install 'brafit[bodies]'") from None
    return anny.create_fullbody_model(all_phenotypes=True, triangulate_faces=True, local_changes=[*LOCAL, PREGNANT])

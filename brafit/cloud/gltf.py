"""glTF 2.0, as .glb or .gltf: the triangles of its default scene, placed by their nodes.

Positions may be whole numbers, normalised or not (KHR_mesh_quantization), or sparse; morph targets and skins count as
the file leaves them, at rest. What is not read (Draco, meshopt, instances) is named.
"""

from __future__ import annotations

import base64
import binascii
import json
import urllib.parse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from brafit.cloud.polygons import Mesh, check_corners
from brafit.cloud.refusal import RefusedError

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
TRIANGLES, STRIP, FAN = 4, 5, 6
"""Modes of a primitive that has a surface."""
NOT_READ = {
    "KHR_draco_mesh_compression": "it is compressed with Draco",
    "EXT_meshopt_compression": "it is compressed with meshopt",
    "KHR_meshopt_compression": "it is compressed with meshopt",
    "EXT_mesh_gpu_instancing": "it places its meshes many times over (EXT_mesh_gpu_instancing)",
}
"""Extensions that change the geometry."""
_HARMLESS = ("KHR_mesh_quantization", "KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_")
"""How extensions begin that may be required and that positions do not depend on, or that are read."""
_MAGIC = b"glTF"


def read_gltf(path: Path) -> Mesh:
    """Vertices and triangles of the default scene, in its frame; without triangles the vertices as a cloud.

    Raises:
        RefusedError: the file uses what is not read.
        ValueError: with a short reason, if it is damaged.
        OSError: the file, or one that it names, cannot be read.
    """
    data = path.read_bytes()
    try:
        text, binary = _chunks(data) if data.startswith(_MAGIC) else (data, b"")
        content = json.loads(text.decode("utf-8-sig"))
        _check_extensions(content)
        return _joined(_Scene(content, binary, path).parts())
    except RefusedError:
        raise
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError):
        raise ValueError("its JSON cannot be read") from None
    except (KeyError, IndexError, TypeError, AttributeError, OverflowError) as error:
        what = " ".join(str(error).split())[:60]
        raise ValueError(f"its JSON does not describe a scene ({type(error).__name__}: {what})") from None


def _chunks(data: bytes) -> tuple[bytes, bytes]:
    """JSON and binary chunk of a GLB."""
    version, length = (int.from_bytes(data[k : k + 4], "little") for k in (4, 8))
    if version != 2:
        raise RefusedError(f"it is a glTF of version {version}", "Export it as glTF 2.0, or as a binary .ply")
    if length > len(data) or data[length:].strip(b"\0 \t\r\n"):
        raise ValueError(f"its header promises {length} bytes, it has {len(data)}")
    found: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = int.from_bytes(data[at : at + 4], "little"), data[at + 4 : at + 8]
        if at + 8 + size > length:
            raise ValueError("one of its chunks goes beyond its end")
        found.setdefault(kind, data[at + 8 : at + 8 + size])
        at += 8 + size
    return found.get(b"JSON", b""), found.get(b"BIN\0", b"")


def _check_extensions(content: dict[str, Any]) -> None:
    for name in content.get("extensionsRequired", ()):
        if name in NOT_READ:
            raise RefusedError(NOT_READ[name], "Export it without that, or as a binary .ply")
        if not name.startswith(_HARMLESS):
            raise RefusedError(f"it needs the extension {name[:60]}", "Export it without that, or as a binary .ply")


class _Scene:
    """What a glTF describes, with its buffers."""

    def __init__(self, content: dict[str, Any], binary: bytes, path: Path):
        self._content, self._path = content, path
        self._buffers: dict[int, bytes] = {}
        self._binary = binary

    def _item(self, kind: str, index: int) -> dict[str, Any]:
        """One of the things that the file lists."""
        items = self._content.get(kind, [])
        if not 0 <= index < len(items):
            raise ValueError(f"it names number {index} of its {kind}, of which it has {len(items)}")
        return items[index]

    def parts(self) -> Iterator[tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "f 3"] | None]]:
        """Placed vertices of each primitive and their triangles; None: points or lines."""
        for index, place in self._placed_nodes():
            node = self._item("nodes", index)
            _refuse_used(node, "EXT_mesh_gpu_instancing")
            mesh = self._item("meshes", node["mesh"])
            weights = node.get("weights", mesh.get("weights", ()))
            for primitive in mesh["primitives"]:
                if "POSITION" in primitive["attributes"]:
                    yield self._part(primitive, weights, place, node.get("skin"))

    def _part(self, primitive: dict, weights: Any, place: np.ndarray, skin: int | None) -> tuple:
        attributes = primitive["attributes"]
        if "bufferView" not in self._item("accessors", attributes["POSITION"]):
            _refuse_used(primitive, "KHR_draco_mesh_compression")
        positions = self._accessor(attributes["POSITION"], 3)
        targets = primitive.get("targets", ())
        if weights and len(weights) != len(targets):
            raise ValueError(f"it gives {len(weights)} weights to {len(targets)} morph targets")
        for weight, target in zip(weights, targets, strict=False):
            if "POSITION" in target:
                positions = positions + float(weight) * self._accessor(target["POSITION"], 3)
        # By the specification a skin places its mesh by its joints alone.
        placed = _moved(place, positions) if skin is None else self._skinned(positions, attributes, skin)
        return placed, self._triangles(primitive, len(positions))

    def _triangles(self, primitive: dict, count: int) -> Int[np.ndarray, "f 3"] | None:
        mode = primitive.get("mode", TRIANGLES)
        if mode not in (TRIANGLES, STRIP, FAN):
            return None
        if "indices" in primitive:
            named = self._accessor(primitive["indices"], 1)[:, 0].astype(np.int64)
            check_corners(named, count)
        else:
            named = np.arange(count)
        if mode == TRIANGLES:
            if len(named) % 3:
                raise ValueError(f"a primitive has {len(named)} corners, which makes no whole number of triangles")
            return named.reshape(-1, 3)
        k = np.arange(max(len(named) - 2, 0))
        first = np.zeros_like(k) if mode == FAN else k
        turned = k % 2 if mode == STRIP else 0
        return named[np.stack([first, k + 1 + turned, k + 2 - turned], axis=1)]

    def _accessor(self, index: int, width: int) -> Float[np.ndarray, "n w"]:
        """The numbers of an accessor, normalised where it says so."""
        accessor = self._item("accessors", index)
        count, kind = int(accessor["count"]), np.dtype(COMPONENTS[accessor["componentType"]])
        if WIDTHS[accessor["type"]] != width:
            raise ValueError(f"an accessor is {accessor['type']}, which does not suit its use")
        if "bufferView" in accessor:
            values = self._view(accessor, kind, count, width).astype(np.float64)
        else:
            values = np.zeros((count, width))
        if "sparse" in accessor:
            sparse = accessor["sparse"]
            index_kind = np.dtype(COMPONENTS[sparse["indices"]["componentType"]])
            chosen = self._view(sparse["indices"], index_kind, sparse["count"], 1).astype(np.int64)
            check_corners(chosen, count)
            values[chosen[:, 0]] = self._view(sparse["values"], kind, sparse["count"], width)
        if accessor.get("normalized") and kind.kind != "f":
            values = np.maximum(values / np.iinfo(kind).max, -1.0)
        return values

    def _view(self, part: dict[str, Any], kind: np.dtype, count: int, width: int) -> np.ndarray:
        """Rows of numbers in a buffer view."""
        view = self._item("bufferViews", part["bufferView"])
        for name in ("EXT_meshopt_compression", "KHR_meshopt_compression"):
            if view.get("extensions", {}).get(name) and self._is_placeholder(view["buffer"]):
                raise RefusedError(NOT_READ[name], "Export it without that, or as a binary .ply")
        row = kind.itemsize * width
        stride, start = view.get("byteStride", row), part.get("byteOffset", 0)
        length = start + stride * (count - 1) + row if count else 0
        buffer = self._buffer(view["buffer"])
        whole = buffer[view.get("byteOffset", 0) :][: view["byteLength"]]
        if min(count, start, stride, view.get("byteOffset", 0)) < 0 or length > len(whole):
            raise ValueError(f"an accessor needs {length} bytes, its buffer view has {len(whole)}")
        if not count:
            return np.empty((0, width), kind)
        return np.ndarray((count, width), kind, whole, start, (stride, kind.itemsize))

    def _is_placeholder(self, index: int) -> bool:
        return "uri" not in self._item("buffers", index) and not (index == 0 and self._binary)

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            description = self._item("buffers", index)
            data = self._binary if index == 0 and "uri" not in description else self._named(description["uri"])
            if len(data) < description["byteLength"]:
                raise ValueError(f"a buffer should have {description['byteLength']} bytes, it has {len(data)}")
            self._buffers[index] = data
        return self._buffers[index]

    def _named(self, uri: str) -> bytes:
        """The bytes that a URI means: its own, or those of a file beside this one."""
        if uri.startswith("data:"):
            try:
                return base64.b64decode(uri.partition(",")[2], validate=True)
            except binascii.Error:
                raise ValueError("a buffer in it is no base64") from None
        file = Path(urllib.parse.unquote(uri))
        if ":" in uri or file.is_absolute() or ".." in file.parts:
            raise RefusedError(f"it keeps its data elsewhere ({uri[:60]})", "Export it as .glb, which holds everything")
        if not (self._path.parent / file).is_file():
            raise RefusedError(f"it keeps its data in {uri[:60]}, which is not beside it", "Put that file beside it")
        return (self._path.parent / file).read_bytes()

    def _placed_nodes(self) -> Iterator[tuple[int, Float[np.ndarray, "4 4"]]]:
        """Nodes with a mesh in the default scene, and where they put it."""
        for index, place in self._places().items():
            if "mesh" in self._item("nodes", index):
                yield index, place

    def _places(self) -> dict[int, Float[np.ndarray, "4 4"]]:
        """The nodes of the default scene, each with its place in the scene."""
        nodes = self._content.get("nodes", [])
        scenes = self._content.get("scenes", [])
        if scenes:
            roots = self._item("scenes", self._content.get("scene", 0)).get("nodes", [])
        else:
            children = {child for node in nodes for child in node.get("children", ())}
            roots = [index for index in range(len(nodes)) if index not in children]
        places: dict[int, np.ndarray] = {}
        waiting = [(index, np.eye(4)) for index in roots]
        while waiting:
            index, parent = waiting.pop()
            if index in places:
                raise ValueError("a node is the child of two others, or of itself")
            node = self._item("nodes", index)
            places[index] = parent @ _local(node)
            waiting += [(child, places[index]) for child in node.get("children", ())]
        return dict(sorted(places.items()))

    def _skinned(self, positions: np.ndarray, attributes: dict, index: int) -> Float[np.ndarray, "v 3"]:
        skin, places = self._item("skins", index), self._places()
        joints = np.stack([places[joint] for joint in skin["joints"]])
        if "inverseBindMatrices" in skin:
            inverse = self._accessor(skin["inverseBindMatrices"], 16).reshape(-1, 4, 4).transpose(0, 2, 1)
            joints = joints @ inverse[: len(joints)]
        placed, total = np.zeros_like(positions), np.zeros((len(positions), 1))
        sets = sorted(name.removeprefix("JOINTS_") for name in attributes if name.startswith("JOINTS_"))
        for number in sets:
            chosen = self._accessor(attributes[f"JOINTS_{number}"], 4).astype(np.int64)
            weights = self._accessor(attributes[f"WEIGHTS_{number}"], 4)
            check_corners(chosen[weights > 0], len(joints))
            for joint, weight in zip(np.where(weights > 0, chosen, 0).T, weights.T[:, :, None], strict=True):
                places_ = joints[joint]
                placed += weight * (np.einsum("vij,vj->vi", places_[:, :3, :3], positions) + places_[:, :3, 3])
                total += weight
        if not (np.abs(total - 1) < 0.01).all():
            raise ValueError("the weights of its skin do not add up to 1")
        return placed / total


def _refuse_used(part: dict[str, Any], name: str) -> None:
    if name in part.get("extensions", {}):
        raise RefusedError(NOT_READ[name], "Export it without that, or as a binary .ply")


def _local(node: dict[str, Any]) -> Float[np.ndarray, "4 4"]:
    """Where a node stands in its parent."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    place = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), dtype=np.float64)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    place[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)), dtype=np.float64)
    place[:3, 3] = node.get("translation", (0, 0, 0))
    return place


def _moved(place: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return points @ place[:3, :3].T + place[:3, 3]


def _joined(parts: Iterator[tuple[np.ndarray, np.ndarray | None]]) -> Mesh:
    vertices, triangles, count = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int64)], 0
    for positions, corners in parts:
        vertices.append(positions)
        if corners is not None:
            triangles.append(corners + count)
        count += len(positions)
    return Mesh(np.concatenate(vertices), np.concatenate(triangles))

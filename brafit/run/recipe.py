"""How scans are loaded, fitted and finished, made of settings or of objects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from brafit.errors import ConfigError
from brafit.settings.entries import locate, made, refusal

if TYPE_CHECKING:
    from brafit.cloud import Reader
    from brafit.fitting import CupFit, Target
    from brafit.fitting.loop import Winners
    from brafit.fitting.solver import Callback
    from brafit.pattern import PatternOptions


NAMED = ("cup", "solver", "hydra.searchpath")
"""What is kept of the choices of groups."""
READING = ("read_seconds", "mesh_points", "readers")
"""Settings of `scan` that are about reading a file."""
AUTO = "auto"
"""Value of `cup.panels` that leaves their number to the scan."""
FEWEST, MOST = 2, 5
"""Panels that `cup.panels=auto` chooses from."""
_TRIAL = (65.0, 200.0)
"""Radius and length of a wire, mm."""


@dataclass(frozen=True)
class Recipe:
    """What is done to every scan.

    Attributes:
        cup: makes the cup, such as a partial of `brafit.cup.FramesCup`.
        solver, condition: what `brafit.fitting.fit_targets` takes.
        pattern: how patterns are finished and which files are written.
        names: what the rows call the cup model (`cup`) and the solver (`solver`), and where these choices were found.
        scan: keyword arguments of `brafit.scan.load_scan`.
        restarts: starts per scan.
        device, dtype: where, and in which precision (`float64`, `float32`), the fit computes.
        settings: anything that says how to repeat the run; goes into every fit.json.
        tolerance: RMS (mm) that the fewest panels are sought for (`cup.panels=auto`); None: `cup` knows their number.
    """

    cup: Callable[..., Any]
    solver: Any
    condition: Any
    pattern: PatternOptions
    names: Mapping[str, Any] = field(default_factory=dict)
    scan: Mapping[str, Any] = field(default_factory=dict)
    restarts: int = 1
    device: str = "cpu"
    dtype: str = "float64"
    settings: Mapping[str, Any] = field(default_factory=dict)
    tolerance: float | None = None

    def with_panels(self, count: int) -> Recipe:
        """The same with cups of so many panels."""
        return replace(self, cup=partial(self.cup, panels=count), tolerance=None)

    def fit(self, targets: Sequence[Target], callback: Callback | None = None, threads: int = 1) -> list[CupFit]:
        """`brafit.fitting.fit_targets` by this recipe.

        Args:
            targets: the scans.
            callback: called with a `Step` after every step.
            threads: processor cores that share the scans, see `fit_targets`.
        """
        from brafit.fitting import fit_targets

        return fit_targets(targets, **self._how(), threads=threads, callback=callback)

    def solve(self, targets: Sequence[Target], callback: Callback | None = None) -> Winners:
        """Where the fits of a batch end; the arguments are those of `fit`."""
        from brafit.fitting.loop import solved

        return solved(targets, **self._how(), callback=callback)

    def measure(self, won: Winners) -> list[CupFit]:
        """The fits of what `solve` gave."""
        from brafit.fitting.loop import finished

        return finished(won, self.cup, self.condition)

    @property
    def compares(self) -> bool:
        """Whether a scan is fitted more than once, and what it gets depends on what is measured of the fits."""
        from brafit.fitting.objective import APEX

        return self.tolerance is not None or self.condition.seam == APEX

    def _how(self) -> dict[str, Any]:
        import torch

        own = {name: getattr(self, name) for name in ("cup", "solver", "condition", "restarts", "device")}
        return own | {"dtype": getattr(torch, self.dtype)}

    @property
    def model(self) -> dict[str, Any]:
        """What rows say of the model: cup, solver, panels, terms; no panels where their number is the scan's."""
        cup = self.settings.get("cup")
        values = dict(cup) if isinstance(cup, Mapping) else {}
        if values.get("panels") == AUTO:
            values["panels"] = None
        return {
            "cup": self.names.get("cup"),
            "solver": self.names.get("solver"),
            "panels": values.get("panels"),
            "terms": values.get("terms"),
        }


def recipe_of(settings: Sequence[str]) -> Recipe:
    """The recipe that the command line would make of `key=value` texts.

    Raises:
        ConfigError: a setting that does not exist or is out of its range.
    """
    from brafit.settings.compose import plain_composed  # Hydra takes a moment

    return recipe_from_settings(*plain_composed((*settings, "out=unused")))


def recipe_from_settings(settings: Mapping[str, Any], names: Mapping[str, Any]) -> Recipe:
    """The recipe of composed settings.

    Args:
        settings: of the command, resolved, as plain values.
        names: the choices of the groups `cup` and `solver`, and where they were looked for, see
            `brafit.settings.compose.composed`.

    Raises:
        ConfigError: a group's settings are not what its `_target_` takes.
    """
    from brafit.report.cup_writers import check_cup_writers  # imports what computes

    scan = {key: value for key, value in settings["scan"].items() if key != "side"}
    cup, tolerance = _panels_of(settings["cup"])
    condition = _made(settings, "condition", "brafit.fitting.Conditions")
    if condition.seam == "apex" and cup.get("panels") == 1:
        raise ConfigError("condition.seam=apex: a cup of one panel has no seam; set cup.panels to 2 or more")
    pattern = _made(settings, "pattern", "brafit.pattern.PatternOptions")
    check_cup_writers(pattern.meshes, pattern.formats)
    return Recipe(
        cup=_cup_of(cup),
        solver=_made(settings, "solver", "brafit.fitting.Solver"),
        condition=condition,
        pattern=pattern,
        names={key: name for key, name in names.items() if key in NAMED},
        scan=scan | {"readers": _readers_of(scan["readers"])},
        restarts=settings["restarts"],
        device=settings["device"],
        dtype=settings["dtype"],
        settings=settings,
        tolerance=tolerance,
    )


def _panels_of(settings: Mapping[str, Any]) -> tuple[dict[str, Any], float | None]:
    """What the cup's maker takes of the settings of `cup`, and the tolerance if the number of panels is the scan's."""
    cup = {key: value for key, value in settings.items() if key != "tolerance"}
    if cup.get("panels") != AUTO:
        return cup, None
    tolerance = settings.get("tolerance")
    if not isinstance(tolerance, int | float) or not tolerance > 0:
        raise ConfigError(f"cup.tolerance={tolerance}: must be above 0 mm where cup.panels={AUTO}")
    return cup | {"panels": FEWEST}, float(tolerance)


def maker_of(settings: Mapping[str, Any]) -> Callable[..., Any]:
    """What makes the cups of their wires, by the settings of `cup`.

    Raises:
        ConfigError: they are not what its `_target_` takes.
    """
    return made({**_panels_of(settings)[0], "_partial_": True}, "cup")


def _cup_of(settings: Mapping[str, Any]) -> Callable[..., Any]:
    """What makes the cups of their wires, tried with one."""
    from brafit.cup import Cup, Wire

    maker = maker_of(settings)
    try:
        cup = maker(Wire.from_arc(*_TRIAL))
    except (ValueError, TypeError, OSError, LookupError) as error:
        raise ConfigError(refusal(error, "cup", "cup")) from error
    if not isinstance(cup, Cup):
        raise ConfigError(f"cup: {settings['_target_']} gives no brafit.cup.Cup: derive its class from that")
    return maker


def _readers_of(settings: Sequence[Any]) -> tuple[Reader, ...]:
    from brafit.cloud.reader import checked_readers

    try:
        return checked_readers(made(settings, "scan.readers"))
    except ValueError as error:
        raise ConfigError(str(error)) from None


def _made(settings: Mapping[str, Any], group: str, kind: str) -> Any:
    """What a group's settings describe, which must be of a kind."""
    thing = made(settings[group], group)
    if not isinstance(thing, locate(kind, group)):
        raise ConfigError(f"{group}: {settings[group]['_target_']} gives no {kind}")
    return thing

"""How scans are loaded, fitted and finished, made of settings or of objects."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from brafit.errors import ConfigError

if TYPE_CHECKING:
    from brafit.fitting import CupFit, Step, Target
    from brafit.pattern import PatternOptions


@dataclass(frozen=True)
class Recipe:
    """What is done to every scan.

    Attributes:
        cup: makes the cup, such as a partial of `brafit.cup.FramesCup`.
        solver, condition: what `brafit.fitting.fit_targets` takes.
        pattern: how patterns are finished and which files are written.
        names: what the rows call the cup model (`cup`) and the solver (`solver`).
        scan: keyword arguments of `brafit.scan.load_scan`.
        restarts: starts per scan.
        device, dtype: where, and in which precision (`float64`, `float32`), the fit computes.
        settings: anything that says how to repeat the run; goes into every fit.json.
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

    def fit(
        self, targets: Sequence[Target], callback: Callable[[Step], None] | None = None, threads: int = 1
    ) -> list[CupFit]:
        """`brafit.fitting.fit_targets` by this recipe.

        Args:
            targets: the scans.
            callback: called with a `Step` after every step.
            threads: processor cores that share the scans.
        """
        import torch

        from brafit.fitting import fit_targets

        return fit_targets(
            targets,
            self.cup,
            self.solver,
            self.condition,
            restarts=self.restarts,
            dtype=getattr(torch, self.dtype),
            device=self.device,
            threads=threads,
            callback=callback,
        )

    @property
    def model(self) -> dict[str, Any]:
        """What rows say of the model: cup, solver, panels, terms."""
        cup = self.settings.get("cup")
        values = cup if isinstance(cup, Mapping) else {}
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
    from brafit.settings.compose import choices_of, from_settings, plain_settings  # Hydra takes a moment

    return recipe_from_settings(plain_settings(from_settings([*settings, "out=unused"])), choices_of(settings))


def recipe_from_settings(settings: Mapping[str, Any], names: Mapping[str, Any]) -> Recipe:
    """The recipe of composed settings.

    Args:
        settings: of the command, resolved, as plain values.
        names: the choices of the groups `cup` and `solver`.

    Raises:
        ConfigError: a group's settings are not what its `_target_` takes.
    """
    return Recipe(
        cup=_build(settings, "cup"),
        solver=_build(settings, "solver"),
        condition=_build(settings, "condition"),
        pattern=_build(settings, "pattern"),
        names={key: names.get(key) for key in ("cup", "solver")},
        scan={key: value for key, value in settings["scan"].items() if key != "side"},
        restarts=settings["restarts"],
        device=settings["device"],
        dtype=settings["dtype"],
        settings=settings,
    )


def _build(settings: Mapping[str, Any], group: str) -> Any:
    from hydra.errors import InstantiationException
    from hydra.utils import instantiate

    try:
        return instantiate(dict(settings[group]))
    except InstantiationException as error:
        said = " ".join(str(error.__cause__ or error).split())
        raise ConfigError(said if said.startswith(f"{group}.") else f"{group}: {said}") from error

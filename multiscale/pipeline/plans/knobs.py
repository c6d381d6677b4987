"""Knobs of accuracy: settings of a case on ladders of rungs, and changes by a rung."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from multiscale.errors import CaseError
from multiscale.pipeline.tables.toml_model import AnySettings

if TYPE_CHECKING:
    from multiscale.pipeline.tables.settings import Case

Setting = Mapping[str, int]
"""Rungs of all knobs of a case, by their names."""

LOWEST, HIGHEST = -2, 6
"""Lowest and highest rung of a plan."""


@dataclass(frozen=True, eq=False)
class CaseKnob:
    """A setting of accuracy on a ladder; rung 0 is the given case."""

    name: str
    change: "Callable[[Case, int], Case]"
    """Return the case at a rung, an equal case if it lacks the setting, or refuse the rung."""
    terms: tuple[str, ...] = ()  # of the error budget, with its error
    orders: tuple[float, float] = (1.0, 2.0)  # powers of 2 by which its error falls, at most
    costs: Mapping[str, float] = field(default_factory=dict)
    """Powers of 2 by which the seconds of stages grow from rung to rung, until measured."""
    measured: bool = True  # by the answer at the rung below; the budget has it otherwise
    scatters: bool = False  # whether cells of another rung have other surfaces
    draws: float = 0.0  # power of 2 by which the sampling error falls
    adds: bool = False  # whether a higher rung adds cells to the cells of the rungs below
    eases: bool = False  # whether solvers that did not converge may converge at a higher rung
    lowers: tuple[str, ...] = ()  # further terms of the budget, if two rungs do not show otherwise
    ratio: "Callable[[Case], float]" = lambda case: 2.0
    """Return the spacing at the rung below over the spacing of a case; 1 for equal spacings."""

    def applies(self, case: "Case") -> bool:
        """Whether a case has the setting."""
        return self._has(case, 1) or self._has(case, -1)

    def lowest(self, case: "Case") -> int:
        """Return the lowest rung of a case at which its error is known.

        A measured knob has another spacing at the rung above its lowest rung.
        """
        rung = 0
        while rung > LOWEST and self._has(case, rung - 1):
            rung -= 1
        for first in range(rung, HIGHEST):
            if self.ratio(self.change(case, first + self.measured)) > 1.0:
                return first
        raise CaseError(
            f"the {self.name} of all settings of [accuracy] are the same, and their error is "
            f"unknown; give other {self.name}, or leave the target out"
        )

    def _has(self, case: "Case", rung: int) -> bool:
        try:
            return self.change(case, rung) != case
        except CaseError:
            return False


def scaled(factors: Mapping[str, float]) -> "Callable[[Case, int], Case]":
    """Return the change that multiplies keys, by their full names, by factors at every rung."""

    def change(case: "Case", rung: int) -> "Case":
        for key, factor in factors.items():
            case = _scale(case, tuple(key.split(".")), factor**rung)
        return case

    return change


def _scale(table: AnySettings, path: tuple[str, ...], factor: float) -> AnySettings:
    """Return a table with a multiplied key; a missing key stays missing."""
    name, *inner = path
    value = getattr(table, name, None)
    if value is None:
        return table

    def changed(entry: Any) -> Any:
        return _scale(entry, tuple(inner), factor) if inner else _times(entry, factor, name)

    new = tuple(map(changed, value)) if isinstance(value, tuple) else changed(value)
    return table.model_copy(update={name: new})


def as_read(value: float) -> float:
    """Return a number with the 15 digits of case files."""
    return float(f"{value:.15g}")


def _times(value: float, factor: float, name: str) -> float:
    """Multiply a number; a whole number must stay whole."""
    new = value * factor
    if not isinstance(value, int):
        return as_read(new)
    if new != round(new) or new < 1:
        raise CaseError(f"{name} = {value} has no whole multiple by {factor:g}")
    return round(new)

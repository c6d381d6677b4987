"""How variables are shown: label, unit and digits, the same in tables, sentences and figures."""

import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from typing import TYPE_CHECKING, Any

from multiscale.units import Unit, shown_unit

if TYPE_CHECKING:
    from xarray import Dataset


@dataclass(frozen=True)
class Show:
    """How a variable is shown."""

    unit: str = "1"  # or the name of a family of units, see multiscale.units.shown_unit
    label: str = ""  # its name in words
    answer: str = ""  # its name among the answers of runs; the label if not given
    digits: int = 4  # significant digits, unless its interval allows fewer
    over: Sequence[str] = ()  # horizontal axis of figures: the first of these in the dataset
    words: Sequence[str] = ()  # meanings of the values 0, 1, ...

    def named(self, name: str) -> "Show":
        """Return it with its labels, by default the name of its variable in words."""
        label = self.label or name.replace("_", " ")
        return replace(self, label=label, answer=self.answer or label)

    def in_unit(self, values: Iterable[float]) -> Unit:
        """Return the unit for showing values, in SI units."""
        return shown_unit(self.unit, values)


def schema_table(name: str) -> dict[str, Any]:
    """Read a table of this package."""
    text = resources.files("multiscale.schema").joinpath(f"{name}.toml").read_text("utf-8")
    return tomllib.loads(text)


def _read_shown() -> dict[str, Show]:
    table = schema_table("shown")
    rows, axes = table["shown"], table["axes"]
    for row in rows.values():
        if "over" in row:
            row["over"] = axes[row["over"]]
    return {name: Show(**row).named(name) for name, row in rows.items()}


SHOWN = _read_shown()
"""Presentation of variables, by names that have the same meaning in all datasets."""


def unit_in(data: "Dataset", name: str) -> Unit:
    """Return the unit of a variable; all stiffnesses share the unit of the first in ``SHOWN``."""
    unit = SHOWN[name].unit
    alike = (key for key in SHOWN if unit == SHOWN[key].unit == "stiffness" and key in data)
    return SHOWN[name].in_unit(data[next(alike, name)].to_numpy().ravel())

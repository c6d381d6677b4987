"""What a page consists of."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Section", "provenance"]


@dataclass
class Section:
    """A part of the page: a heading and what stands below it."""

    heading: str
    lines: list[str]
    head: tuple[str, ...] = ()
    rows: Sequence[tuple[str, ...]] = ()
    figures: tuple[str, ...] = ()


def provenance(result: "xr.Dataset") -> list[tuple[str, ...]]:
    """Say with what a dataset was computed, by which command and when."""
    rows = [("program", str(result.attrs["source"]))]
    if "environment" in result.attrs:  # a run of an earlier version has none
        rows.append(("computed with", str(result.attrs["environment"])))
    return [*rows, ("command", str(result.attrs["history"]))]

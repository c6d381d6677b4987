"""What a page consists of."""

from collections.abc import Sequence
from dataclasses import dataclass

__all__ = ["Section"]


@dataclass
class Section:
    """A part of the page: a heading and what stands below it."""

    heading: str
    lines: list[str]
    head: tuple[str, ...] = ()
    rows: Sequence[tuple[str, ...]] = ()
    figures: tuple[str, ...] = ()

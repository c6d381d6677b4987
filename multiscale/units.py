"""Conversion of quantities with units to floats in SI units."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from html import escape
from math import floor, inf, isfinite, log10
from typing import TYPE_CHECKING, Any

from multiscale.errors import CaseError

if TYPE_CHECKING:
    import pint

ZERO_CELSIUS = 273.15
"""Melting point of ice, K."""

# a plain number, then names with short powers, so that the parser has no expression to compute
_QUANTITY = re.compile(
    r"\s*(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|[-+]?(?:nan|inf))"
    r"\s*(?P<unit>(?:[^\W\d]+|%)(?:(?:\^|\*\*)-?\d(?:\.5)?)?"
    r"(?:\s*[/*·]\s*[^\W\d]+(?:(?:\^|\*\*)-?\d(?:\.5)?)?){0,4})?\s*",
    re.IGNORECASE,
)


# units of most quantities, read and written without pint, which takes half a second to load
_PREFIXES = {"": 0, "G": 9, "M": 6, "k": 3, "m": -3, "u": -6, "µ": -6, "n": -9}
_PREFIXED = ("m", "Pa", "N")
_NOTHING = 1e-13  # in these units: round-off

_BETWEEN_LENGTHS = re.compile(r"\s*(?:[x×*;]|\bby\b|,(?=\s)|(?<=[^\W\d])(?:,|\s))\s*(?=[-+.\d])")


@cache
def _registry() -> "pint.UnitRegistry[Any]":
    import pint

    return pint.UnitRegistry()


def to_si(text: object, unit: str) -> float:
    """Convert a quantity such as ``"0.8 um"`` to a float in an SI unit.

    >>> to_si("0.8 um", "m")
    8e-07
    >>> to_si("210 GPa", "Pa")
    210000000000.0
    """
    if unit == "1" and isinstance(text, int | float) and not isinstance(text, bool):
        number = float(text)
    elif not isinstance(text, str):
        shown = f"{text:g}" if isinstance(text, float) else text
        raise CaseError(f'{text!r} has no unit; write it as text, such as "{shown} {unit}"')
    else:
        quantity = _QUANTITY.fullmatch(text)
        if quantity is None:
            if "," in text:
                raise CaseError(f"{text!r} has a comma; write its number with a decimal point")
            raise CaseError(
                f'{text!r} is not a quantity; write a number and a unit, such as "1 {unit}"'
            )
        if unit != "1" and not quantity["unit"]:
            raise CaseError(f'{text!r} has no unit; write a number and a unit, such as "1 {unit}"')
        try:
            number = _convert(quantity["number"], quantity["unit"], unit)
        except Exception as error:  # pint raises exceptions of many kinds
            import pint

            form = f'write a quantity such as "1 {unit}"'
            reason = {
                pint.DimensionalityError: f"cannot be converted to {unit}; {form}",
                pint.UndefinedUnitError: f"has an unknown unit; capitals count, as in "
                f'"1 MPa" and "1 mPa"; {form}',
            }.get(type(error), f"is not a quantity; {form}")
            raise CaseError(f"{text!r} {reason}") from error
    if not isfinite(number):
        raise CaseError(f"{text!r} is not finite; give a number")
    return number


def to_lengths(text: str) -> tuple[float, ...]:
    """Convert an edge length, or two, to m.

    >>> to_lengths("90 um x 130 um"), to_lengths("90 x 130 um"), to_lengths("(1.5mm, 1mm)")
    ((9e-05, 0.00013), (9e-05, 0.00013), (0.0015, 0.001))
    """
    lengths = _BETWEEN_LENGTHS.split(text.strip(" ()[]"))
    last = _QUANTITY.fullmatch(lengths[-1])
    if last is None or len(lengths) > 2:
        raise CaseError(
            f'{text!r} is not a size; write two lengths such as "90 um x 130 um", or the length of '
            f"a line scan, with decimal points"
        )
    bare = re.compile(r"[-+.\de]+", re.IGNORECASE)
    return tuple(
        to_si(f"{length} {last['unit'] or ''}" if bare.fullmatch(length) else length, "m")
        for length in lengths
    )


def _power(given: str | None, unit: str) -> int | None:
    """Power of ten of a prefix before a unit; None for pint to find out."""
    if given == unit:
        return 0
    if given is None or unit not in _PREFIXED or not given.endswith(unit):
        return None
    return _PREFIXES.get(given.removesuffix(unit))


@lru_cache(maxsize=4096)  # points of a sweep repeat their quantities
def _convert(number: str, given: str, unit: str) -> float:
    if (power := _power(given, unit)) is not None:
        return float(f"{float(number) * 10.0**power:.15g}")
    quantity: Any = _registry().Quantity(float(number), given)
    # via the decimal text of the number, so that "0.8 um" is exactly 8e-07
    return float(f"{quantity.to(unit).magnitude:.15g}")


@dataclass(frozen=True)
class Unit:
    """A unit in which values are shown: ``scale`` times the SI value, plus ``zero``."""

    name: str
    scale: float
    zero: float = 0.0

    def shown(self, value: Any) -> Any:
        """Return a number, or an array, in this unit."""
        return self.scale * value + self.zero


STIFFNESS_UNITS = (Unit("MPa/µm", 1e-12), Unit("MPa/mm", 1e-9), Unit("kPa/mm", 1e-6))
LENGTH_UNITS = (Unit("m", 1.0), Unit("mm", 1e3), Unit("µm", 1e6), Unit("nm", 1e9))


def stiffness_unit(values: Iterable[float]) -> Unit:
    """Choose the unit of stiffnesses per area, Pa/m: soft joints are shown in MPa/mm.

    >>> stiffness_unit([1.2e13, 2e13]).name, stiffness_unit([4.4e8]).name
    ('MPa/µm', 'MPa/mm')
    """
    return _largest(values, STIFFNESS_UNITS, 0.1)


def length_unit(values: Iterable[float]) -> Unit:
    """Choose the largest unit of lengths, m, in which no finite length is below 1."""
    return _largest(values, LENGTH_UNITS, 1.0)


def _largest_length(values: Iterable[float]) -> Unit:
    """Choose the largest unit in which the largest of some lengths, m, is not below 1."""
    return length_unit([max((abs(value) for value in values if isfinite(value)), default=0.0)])


SHOWN = {
    name: Unit(name, scale)
    for name, scale in {
        **{"1": 1.0, "%": 100.0, "% of critical": 100.0, "cycles": 1.0},
        **{"m": 1.0, "mm": 1e3, "µm": 1e6, "s": 1.0, "m/s": 1.0, "Hz": 1.0, "kg^1/2 m": 1.0},
        **{"Pa": 1.0, "kPa": 1e-3, "MPa": 1e-6, "GPa": 1e-9, "N": 1.0, "kN": 1e-3, "N/µm": 1e-6},
        **{"J": 1.0, "mJ": 1e3, "J/m²": 1.0, "ml/h": 3.6e9},
        **{"kW/(m² K)": 1e-3, "S/mm²": 1e-6},
    }.items()
} | {"°C": Unit("°C", 1.0, -ZERO_CELSIUS)}
"""Units in which variables are shown, by their names; the SI unit of a name is fixed."""

FAMILIES = {
    "stiffness": stiffness_unit,
    "length": length_unit,
    "largest length": _largest_length,
}
"""Names of units that depend on the values."""


def shown_unit(name: str, values: Iterable[float] = ()) -> Unit:
    """Return a unit in which values are shown, by its name or the name of a family of units."""
    return FAMILIES[name](values) if name in FAMILIES else SHOWN[name]


def _largest(values: Iterable[float], units: tuple[Unit, ...], least: float) -> Unit:
    """Return the first of the units in which the smallest value is at least ``least``."""
    smallest = min((abs(x) for x in values if isfinite(x) and x != 0.0), default=inf)
    fitting = (unit for unit in units if smallest * unit.scale >= least)
    return next(fitting, units[-1])


def readable(value: object) -> str:
    """Format a value for reading, a quantity with a prefix for a short number.

    >>> readable("2000000.0 Pa"), readable("4e-07 m"), readable("0.01 m/s"), readable("flat")
    ('2 MPa', '400 nm', '10 mm/s', 'flat')
    """
    quantity = _QUANTITY.fullmatch(value) if isinstance(value, str) else None
    if quantity is None or quantity["unit"] is None or quantity["unit"].startswith("%"):
        return str(value)
    for unit in _PREFIXED:
        if (power := _power(quantity["unit"], unit)) is not None:
            number = float(quantity["number"]) * 10.0**power
            number = number if abs(number) > _NOTHING else 0.0
            fits = 3 * floor(log10(abs(number)) / 3.0) if number and isfinite(number) else 0
            prefix = next(
                (name for name, ten in _PREFIXES.items() if ten == fits and name != "u"), None
            )
            if prefix is not None:
                return f"{number / 10.0**fits:.6g} {prefix}{unit}"
    try:
        compact = _registry()(f"{value}").to_compact()
    except Exception:  # a text that resembles a quantity
        return str(value)
    return f"{compact.magnitude:.6g} {compact.units:~P}"


def html_table(title: str, rows: Mapping[str, object]) -> str:
    """Return names and values as a table for notebooks, with :func:`readable` quantities."""
    cells = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(readable(value))}</td></tr>"
        for name, value in rows.items()
    )
    return f"<table><caption>{escape(title)}</caption>{cells}</table>"

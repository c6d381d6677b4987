"""Quantities with units become SI floats, or a sentence."""

from itertools import product

import pytest

from multiscale.errors import CaseError
from multiscale.units import readable, to_lengths, to_si


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("0.8 um", "m", 8e-7),
        ("0.8 µm", "m", 8e-7),
        ("3 nm", "m", 3e-9),
        ("2 km", "m", 2000.0),
        ("210 GPa", "Pa", 2.1e11),
        ("2 N/mm^2", "Pa", 2e6),
        (0.3, "1", 0.3),
        ("30 percent", "1", 0.3),
    ],
)
def test_quantities_are_exact_in_si(text, unit, value):
    assert to_si(text, unit) == value


def test_prefixes_are_read_and_written_as_pint_does():
    import pint

    registry = pint.UnitRegistry()
    for number, prefix, unit in product(
        ("0.8", "-0.3", "999.9996", "1000", "12345.678"), ("n", "µ", "m", "", "k", "M"), "mN"
    ):
        text = f"{number} {prefix}{unit}"
        quantity = registry(text)
        assert to_si(text, unit) == float(f"{quantity.to(unit).magnitude:.15g}")
        compact = quantity.to_compact()
        assert readable(text) == f"{compact.magnitude:.6g} {compact.units:~P}".replace(
            "\u03bc", "\u00b5"
        )
    assert readable("-5e-28 m") == "0 m"


@pytest.mark.parametrize(
    "text",
    ["1 mm, 2mm", "1 mm x 2mm", "1x2 mm", "1mmx2mm", "(1 mm, 2 mm)", "1 mm × 2 mm", "1 by 2 mm"],
)
def test_sizes_are_read_as_people_write_them(text):
    assert to_lengths(text) == (1e-3, 2e-3)


@pytest.mark.parametrize("text", ["1,5 mm", "1 mm x 1 mm x 1 mm", "x", "1,5 mm x 2 mm", "1 x 2"])
def test_a_text_without_a_size_is_refused(text):
    with pytest.raises(CaseError, match=r"not a size|comma|no unit"):
        to_lengths(text)

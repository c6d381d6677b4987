"""Quantities with units become SI floats, or a sentence."""

import pytest

from multiscale.errors import CaseError
from multiscale.units import to_si


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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        pytest.param("5", "'5' has no unit", id="bare-text"),
        pytest.param(5, 'write it as text, such as "5 m"', id="bare-number"),
        pytest.param("5 kg", "cannot be converted to m", id="dimension"),
        pytest.param("5 umm", "has an unknown unit; capitals count", id="unknown-unit"),
        pytest.param("0,8 um", "has a comma; .* decimal point", id="decimal-comma"),
        pytest.param("nan m", "is not finite", id="nan"),
        pytest.param("__import__('os')", "is not a quantity", id="code"),
        pytest.param("9**9**9 m", "is not a quantity", id="power-tower"),
        pytest.param("1 m**9**9", "is not a quantity", id="unit-tower"),
        pytest.param(None, "has no unit", id="nothing"),
    ],
)
def test_what_is_not_a_length_is_refused(text, message):
    with pytest.raises(CaseError, match=message):
        to_si(text, "m")

"""Properties of all answers: they scale with lengths and stresses, and have the right sense."""

import re
from functools import cache

import numpy as np
import pytest
from pint import UnitRegistry

from multiscale.pipeline import run
from multiscale.pipeline.stages import stages_of
from tests.support import SCENES, case_of, case_text, small_steel

LENGTH, STRESS = 3.0, 0.5
QUANTITY = re.compile(r'"([-+]?[\d.]+(?:e[-+]?\d+)?) ([A-Za-zµ][^" ]*)"')
UNITS = UnitRegistry()
TEXTS = {
    "steel": small_steel(3),
    "ring": case_text("seal"),
    "cracks": case_text("cracked_volume"),
    "plate": (SCENES / "plate.toml").read_text("utf-8"),
    "cable_net": (SCENES / "cable_net.toml").read_text("utf-8"),
}


def factor(unit):
    """Factor of a quantity with all lengths and stresses, at the same times."""
    dimension = UNITS.get_dimensionality(UNITS.parse_units(unit))
    mass = dimension.get("[mass]", 0)  # kg = Pa m s2
    return STRESS**mass * LENGTH ** (mass + dimension.get("[length]", 0))


def scaled(text):
    """A case with all quantities that have a unit scaled."""
    return QUANTITY.sub(lambda m: f'"{float(m[1]) * factor(m[2])!r} {m[2]}"', text)


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """Return the answers of a case, once: values by stage and variable, with their units."""

    @cache
    def solve(text, *pairs):
        folder = tmp_path_factory.mktemp("case")
        case = case_of(folder, text, *pairs)
        case = case if case.micro else case.quick()
        result = run(case, folder / "out")
        return {
            f"{stage.name}.{name}": (values.values, values.attrs["units"])
            for stage in stages_of(case.tables)
            for name, values in stage.compared(result[stage.name]).items()
            if name in stage.answers
        }

    return solve


@pytest.mark.slow
@pytest.mark.parametrize("name", TEXTS)
def test_answers_scale_with_lengths_and_stresses(answers, name):
    first, other = answers(TEXTS[name]), answers(scaled(TEXTS[name]))
    assert first
    for key, (values, unit) in first.items():
        by = factor(re.sub(r"(?<=[a-z])(-?\d)", r"**\1", unit).replace(" ", "*"))
        np.testing.assert_allclose(other[key][0], by * values, rtol=1e-4, err_msg=key)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "pair", "answer", "rises"),
    [
        ("steel", ("0.4 um", "0.6 um"), "macro_result.joint_stiffness", False),
        ("steel", ("210 GPa", "300 GPa"), "macro_result.joint_stiffness", True),
        ("steel", ("210 GPa", "300 GPa"), "interface_law.contact_fraction", False),
        ("ring", ("1.5 um", "2 um"), "seal.leak_rate", True),
        ("ring", ("10 MPa", "20 MPa"), "seal.leak_rate", True),
        ("cracks", ("0.6 MPa*m^0.5", "0.8 MPa*m^0.5"), "volume_growth.strength", True),
        ("plate", ("70 GPa", "140 GPa"), "macro_result.largest_displacement", False),
        ("cable_net", ("10 kN", "20 kN"), "macro_result.largest_displacement", False),
    ],
)
def test_answers_rise_or_fall_as_they_should(answers, name, pair, answer, rises):
    first, other = (answers(TEXTS[name], *pairs)[answer][0] for pairs in ((), (pair,)))
    open_or_loaded = first > 0.0
    assert open_or_loaded.any()
    assert np.all((other > first)[open_or_loaded] == rises), (first, other)


@pytest.mark.parametrize(
    ("name", "answer", "rises"),
    [
        ("steel", "macro_result.joint_stiffness", True),
        ("steel", "interface_law.contact_fraction", True),
        ("steel", "interface_law.mean_gap", False),
        ("ring", "seal.leak_rate", False),
    ],
)
def test_answers_rise_or_fall_with_the_pressure(answers, name, answer, rises):
    values = answers(TEXTS[name])[answer][0]
    assert values.size > 2
    assert np.all((np.diff(values[values > 0.0]) > 0.0) == rises), values

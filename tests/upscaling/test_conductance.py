"""Conductance of an interface from its law: closed form, branches, export."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.schema import INTERFACE_LAW
from multiscale.upscaling import (
    conductances,
    elastic_dependence,
    fit_law,
    with_conductance,
    write_pressure_overclosure,
)
from tests.upscaling.responses import response_of

PAIR = {"thermal_conductance": (200.0, 50.0), "electrical_conductance": (3.5e7, 6e6)}
MODULUS = 60e9  # Pa


@pytest.fixture(scope="module")
def law():
    """Exponential law: K = p / delta, of one decay length."""
    gap = 1e-6 - 0.2e-6 * np.log(np.geomspace(1e6, 1e8, 9) / 1e6)
    return fit_law(response_of(gap[None], np.geomspace(1e6, 1e8, 9)), n_samples=0)


def test_an_interface_conducts_as_its_stiffness_says(law):
    found = conductances(
        with_conductance(law, PAIR, MODULUS, flows=False), p := np.array([3e6, 1e7, 5e7])
    )
    stiffness = p / 0.2e-6
    for name, (one, two) in PAIR.items():
        expected = 2.0 * stiffness / (MODULUS * (1.0 / one + 1.0 / two))
        np.testing.assert_allclose(found[name], expected, rtol=3e-3)


def test_metal_that_flows_conducts_by_its_elastic_stiffness(law):
    unloaded = INTERFACE_LAW.assign(
        law,
        {
            "unloading_stiffness_ratio": 1.4,
            "unloading_stiffness_ratio_sample": np.linspace(1.3, 1.5, 41),
        },
    )
    p = np.array([1e7])
    plain, flowing = (
        with_conductance(unloaded, PAIR, MODULUS, flows=flows) for flows in (False, True)
    )
    for name in PAIR:
        assert conductances(flowing, p)[name] == pytest.approx(1.4 * conductances(plain, p)[name])
    of_heat = np.array([[True], [False]])
    half = elastic_dependence(flowing, of_heat).half_width["sampling"]
    assert half == pytest.approx(0.5 * 0.95 * 0.2 / 1.4)
    assert elastic_dependence(plain, of_heat).half_width["sampling"] == 0.0
    without = with_conductance(law, PAIR, MODULUS, flows=True)
    assert "it is too small; ask for unload" in without.attrs["cautions"]


def test_other_codes_read_the_conductance_against_pressure(law, tmp_path):
    conducting = with_conductance(law, PAIR, MODULUS, flows=False)
    for code, head in (("abaqus", "*GAP CONDUCTANCE, PRESSURE"), ("calculix", "*GAP CONDUCTANCE")):
        write_pressure_overclosure(
            conducting, tmp_path / "law.inp", tolerance=0.02, conductance_for=code
        )
        lines = (tmp_path / "law.inp").read_text().splitlines()
        start = lines.index(head) + 1
        rows = np.array([[float(one) for one in line.split(",")] for line in lines[start:]])
        assert np.all(rows[0] == 0.0)
        expected = conductances(conducting, 1e6 * rows[1:, 1])["thermal_conductance"]
        np.testing.assert_allclose(rows[1:, 0], 1e-3 * expected)  # mW, mm, K
    with pytest.raises(CaseError, match="no thermal conductance; give thermal_conductivity"):
        write_pressure_overclosure(
            law, tmp_path / "law.inp", tolerance=0.02, conductance_for="calculix"
        )

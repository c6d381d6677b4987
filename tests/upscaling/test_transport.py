"""Conduction and leakage of interfaces: conductance by stiffness, leakage by percolation."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.schema import INTERFACE_LAW, MICRO_RESPONSE
from multiscale.upscaling import fit_law, say_sealing, write_law_table, write_pressure_overclosure
from multiscale.upscaling.transport import (
    conductances,
    effective_permeability,
    elastic_source,
    sealing_pressures,
    with_conductance,
    with_leakage,
)
from tests.upscaling.responses import response_of

PAIR = {"thermal_conductance": (200.0, 50.0), "electrical_conductance": (3.5e7, 6e6)}
MODULUS = 60e9  # Pa


@pytest.fixture(scope="module")
def law():
    """Exponential law: K = p / delta, of one decay length."""
    gap = 1e-6 - 0.2e-6 * np.log(np.geomspace(1e6, 1e8, 9) / 1e6)
    return fit_law(response_of(gap[None], np.geomspace(1e6, 1e8, 9)), n_samples=0)


def test_an_interface_conducts_by_its_stiffness(law):
    conductance = conductances(
        with_conductance(law, PAIR, MODULUS, flows=False), p := np.array([3e6, 1e7, 5e7])
    )
    stiffness = p / 0.2e-6
    for name, (value, two) in PAIR.items():
        expected = 2.0 * stiffness / (MODULUS * (1.0 / value + 1.0 / two))
        np.testing.assert_allclose(conductance[name], expected, rtol=3e-3)


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
    half = elastic_source(flowing, of_heat).half_width["sampling"]
    assert half == pytest.approx(0.5 * 0.95 * 0.2 / 1.4)
    assert elastic_source(plain, of_heat).half_width["sampling"] == 0.0
    without = with_conductance(law, PAIR, MODULUS, flows=True)
    assert "so the conductance is too small; set unload" in without.attrs["cautions"]


def test_other_codes_read_the_conductance_against_pressure(law, tmp_path):
    conducting = with_conductance(law, PAIR, MODULUS, flows=False)
    for code, head in (("abaqus", "*GAP CONDUCTANCE, PRESSURE"), ("calculix", "*GAP CONDUCTANCE")):
        write_pressure_overclosure(
            conducting, tmp_path / "law.inp", tolerance=0.02, conductance_for=code
        )
        lines = (tmp_path / "law.inp").read_text().splitlines()
        start = lines.index(head) + 1
        rows = np.array([[float(entry) for entry in line.split(",")] for line in lines[start:]])
        assert np.all(rows[0] == 0.0)
        expected = conductances(conducting, 1e6 * rows[1:, 1])["thermal_conductance"]
        np.testing.assert_allclose(rows[1:, 0], 1e-3 * expected)  # mW, mm, K
    with pytest.raises(CaseError, match="no thermal conductance; give thermal_conductivity"):
        write_pressure_overclosure(
            law, tmp_path / "law.inp", tolerance=0.02, conductance_for="calculix"
        )


PRESSURE = np.geomspace(1e6, 1e8, 9)


def even(*cells):
    """Effective permeability of an interface with equal parts of some cells."""
    return effective_permeability(np.array(cells)[:, None], np.ones((1, len(cells), 1))).item()


def test_a_patchwork_conducts_as_by_bruggeman():
    assert even(2.0, 2.0, 2.0) == pytest.approx(2.0)
    assert even(1.0, 9.0) == pytest.approx(3.0)  # a chessboard: the geometric mean
    assert even(5.0, 5.0, 5.0, 0.0) == pytest.approx(5.0 * (2.0 * 0.75 - 1.0))
    assert even(5.0, 5.0, 0.0, 0.0) == 0.0  # percolation at one half
    assert even(0.0, 0.0) == 0.0
    k = np.exp(np.random.default_rng(2).normal(size=400))
    twice = effective_permeability(k[:, None], np.concatenate([[2.0], np.ones(399)])[None, :, None])
    assert twice.item() == pytest.approx(even(k[0], *k))


def test_the_effective_permeability_of_a_lognormal_gap_is_its_geometric_mean():
    deviation = 0.3
    quantiles = np.linspace(-6.0, 6.0, 4001)
    weight = np.exp(-0.5 * quantiles**2)[None, :, None]
    permeability = effective_permeability(np.exp(deviation * quantiles)[:, None], weight)
    assert permeability.item() == pytest.approx(1.0, rel=1e-9)


def leaking_cells():
    """Response of twelve cells that close one after the other along y, and all leak along x."""
    gap = 1e-6 - 0.2e-6 * np.log(PRESSURE / 1e6) + 1e-9 * np.arange(12)[:, None]
    response = response_of(gap, PRESSURE)
    aperture = np.repeat(0.5 * gap[..., None], 2, axis=-1)
    aperture[..., 1] *= np.geomspace(3e6, 5e7, 12)[:, None] > PRESSURE
    values = {"hydraulic_aperture": aperture, "percolating_share": aperture > 0.0}
    return MICRO_RESPONSE.assign(response, values)


def leaking_law(coarser=None):
    response, text = leaking_cells(), {"cell_size": 8e-4, "longest_wave": 2e-4}
    return with_leakage(fit_law(response, n_samples=20).assign_attrs(text), response, coarser)


@pytest.fixture(scope="module")
def leaking():
    return leaking_law()


def test_a_law_has_apertures_with_bands_and_where_it_is_tight(leaking):
    x, y = (leaking.sel(direction=name) for name in "xy")
    mean = 0.5 * leaking["fit_mean_gap"]
    np.testing.assert_allclose(x["hydraulic_aperture"], mean, rtol=1e-3)
    np.testing.assert_allclose(x["percolating_cells"], 1.0)
    half = y["percolating_cells"].to_numpy() <= 0.5
    np.testing.assert_array_equal(y["hydraulic_aperture"] == 0.0, half)
    low, high = y["hydraulic_aperture_mean_law"].to_numpy()
    assert np.all((low <= y["hydraulic_aperture"]) & (y["hydraulic_aperture"] <= high))
    first = int(np.argmax(half))
    assert high[first] > 0.0  # unknown whether tight
    np.testing.assert_allclose(sealing_pressures(leaking, "y"), PRESSURE[first - 1 : first + 1])
    np.testing.assert_array_equal(sealing_pressures(leaking, "x"), [PRESSURE[-1], np.nan])
    mixed = PRESSURE[(y["percolating_cells"] > 0.0) & (y["percolating_cells"] < 1.0)]
    sentence = say_sealing(leaking, "y")
    assert "is tight from" in sentence
    assert sentence.endswith(f"others open at {', '.join(f'{1e-6 * p:.4g}' for p in mixed)} MPa.")
    assert say_sealing(leaking, "x").endswith("up to the highest pressure, 100 MPa.")
    assert "longest waves" not in leaking.attrs.get("cautions", "")


def test_intervals_count_the_grid_by_the_same_cells_on_half_of_the_points(leaking):
    cells = leaking_cells()
    coarser = cells.assign(hydraulic_aperture=0.9 * cells["hydraulic_aperture"]).isel(
        realisation=range(4)
    )
    x, alone = (law.sel(direction="x") for law in (leaking_law(coarser), leaking))
    first = leaking_cells()["hydraulic_aperture"][:4, :, 0].mean("realisation")
    grid = 1.25 * 0.1 * first  # of first order, with Roache's factor of safety
    for end, computed in zip(
        *(item["hydraulic_aperture_mean_law"] for item in (x, alone)), strict=True
    ):
        half = np.abs(computed - alone["hydraulic_aperture"])
        expected = np.hypot(half, grid)
        np.testing.assert_allclose(np.abs(end - x["hydraulic_aperture"]), expected, rtol=1e-3)
    assert "half of the points" in x.attrs["leakage_intervals"]
    assert "coarser in [micro]" in alone.attrs["leakage_intervals"]


def test_codes_of_flow_read_apertures_against_gap_and_pressure(leaking, tmp_path):
    write_law_table(leaking, tmp_path / "gap.csv", leakage=True)
    table = np.genfromtxt(tmp_path / "gap.csv", delimiter=",", names=True, deletechars="")
    np.testing.assert_allclose(table["pressure_(MPa)"], 1e-6 * PRESSURE)
    y = leaking["hydraulic_aperture"].sel(direction="y")
    np.testing.assert_allclose(table["aperture_y_(um)"], 1e6 * y, rtol=1e-8)
    bare = leaking.drop_vars("hydraulic_aperture")
    with pytest.raises(CaseError, match="no hydraulic aperture; set leakage = true"):
        write_law_table(bare, tmp_path / "gap.csv", leakage=True)

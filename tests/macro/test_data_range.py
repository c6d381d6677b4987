"""Share of a load outside the data of a law, and the answers that are then unknown."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.laws import Exponential, HystereticLaw, NormalLaw, PowerLaw
from multiscale.macro import Block, press_joint
from multiscale.macro.data_range import data_ends, load_shares, with_load_shares
from multiscale.schema import MACRO_RESULT
from multiscale.upscaling import Family, Parameter, fit_law, law_from_dataset, observe
from tests.pressed_joint import ElementJoint, press_blocks

BLOCK = Block(0.02, 210e9, 0.3)
LAW = Exponential(4e9, 0.7e-6, pressure_range=(2e6, 30e6))
PRELOADS = np.array([0.9e6, 1e6, 2e6, 30e6, 60e6, 61e6, 5e9])


def joint(eccentricity=None):
    mesh = {"elements": (8, 1), "layers": (1, 1)}
    return ElementJoint((0.05, 0.04), BLOCK, BLOCK, **mesh, eccentricity=eccentricity)


def test_the_shares_of_a_linear_pressure_equal_its_integral():
    """With p = P x the load below a pressure a is (a/P)^2 of it."""
    x = (np.arange(20_000) + 0.5) / 20_000
    pressure = np.array([8e6, 1e6])[:, None] * x
    below, above, far = load_shares(pressure, np.ones(x.size), (2e6, 3e6, 6e6))
    np.testing.assert_allclose(below, [1 / 16, 1.0], rtol=1e-3)
    np.testing.assert_allclose(above, [1 - 9 / 64, 0.0], rtol=1e-3)
    np.testing.assert_allclose(far, [1 / 64 + 1 - 36 / 64, 1.0], rtol=1e-3)


def test_points_count_by_their_area_and_a_failed_step_has_no_share():
    pressure = np.array([[1.0, 4.0], [0.0, 0.0], [np.nan, np.nan]])
    below, above, far = load_shares(pressure, np.array([3.0, 1.0]), (2.0, 8.0, 16.0))
    np.testing.assert_allclose(below, [3 / 7, 0.0, np.nan])
    np.testing.assert_allclose(above, [0.0, 0.0, np.nan])
    np.testing.assert_allclose(far, [0.0, 0.0, np.nan])


@pytest.mark.parametrize("law", [LAW, HystereticLaw(LAW, 1.5, 2.0)])
def test_an_even_preload_is_known_up_to_a_factor_of_two_outside_the_data(law):
    result = press_joint(joint(), law, PRELOADS, samples=[law])
    assert result["converged"].values.all()
    np.testing.assert_array_equal(result["known"], [0, 1, 1, 1, 1, 0, 0])
    np.testing.assert_allclose(result["load_below"][:, 0], [1, 1, 0, 0, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(result["load_above"][:, 0], [0, 0, 0, 0, 1, 1, 1], atol=1e-9)
    for name in ("joint_stiffness", "mean_gap", "approach", "interface_stiffness"):
        np.testing.assert_array_equal(np.isfinite(result[name]), result["known"] == 1)
    sampled = np.isfinite(result["joint_stiffness_sample"][0])
    np.testing.assert_array_equal(sampled, result["known"] == 1)
    assert "at 3 of 7 steps, first at step 0 with the preload 900 kPa" in result.attrs["cautions"]
    assert np.isfinite(result["solid_stiffness"]).all()  # no law enters it
    outcome = press_joint(joint(), law, PRELOADS, extrapolate=True)
    assert float(outcome["mean_gap"][-1]) < 0.0  # extrapolation of the law at 5 GPa
    np.testing.assert_array_equal(outcome["known"], result["known"])


def test_an_eccentric_joint_counts_the_load_of_its_edge():
    preload = np.array([5e6, 25e6])
    pressed = press_blocks(joint((0.012, 0.0)), LAW, preload)
    below, above, _ = load_shares(pressed.pressure, pressed.weight, data_ends(LAW))
    even = press_joint(joint(), LAW, preload)
    assert even["load_above"].values.max() == 0.0
    assert 0.0 < above[1] < 1.0
    assert below[0] > 0.0


@pytest.mark.parametrize("family", ["exponential", "power", None])
def test_a_fitted_law_of_any_family_has_its_data_range(family):
    p = np.geomspace(1e6, 50e6, 8)
    law = PowerLaw(1e9, 2e-6, 2.0)
    fitted = fit_law(observe("gap", p, law.gap_at(p)), family=family, n_samples=0)
    assert law_from_dataset(fitted).pressure_range == pytest.approx((1e6, 50e6))


def own_family(law):
    return Family(
        "own",
        ("gap",),
        {"pressure_scale": Parameter("Pa")},
        make=lambda pressure_scale: law(pressure_scale, 0.5e-6),
        start=lambda seen: {"pressure_scale": float(seen.pressure.max())},
    )


def test_a_fitted_law_of_a_user_family_has_its_data_range():
    p = np.geomspace(1e6, 50e6, 8)
    seen, family = observe("gap", p, Exponential(2e9, 0.5e-6).gap_at(p)), own_family(Exponential)
    law = law_from_dataset(fit_law(seen, family=family, n_samples=0), family=family)
    assert law.pressure_range == pytest.approx((1e6, 50e6))
    assert law.pressure_scale == pytest.approx(2e9)
    known = press_joint(joint(), law, np.array([10e6, 5e9]))["known"]
    np.testing.assert_array_equal(known, [1, 0])


def test_a_law_without_a_place_for_its_data_is_refused():
    class Placeless(NormalLaw):
        def __init__(self, scale, length):
            self.law = Exponential(scale, length)

        def pressure(self, gap):
            return self.law.pressure(gap)

        def stiffness(self, gap):
            return self.law.stiffness(gap)

        def gap_at(self, pressure):
            return self.law.gap_at(pressure)

    p = np.geomspace(1e6, 50e6, 8)
    seen = observe("gap", p, Exponential(2e9, 0.5e-6).gap_at(p))
    with pytest.raises(CaseError, match="Placeless has no field for the pressures of its data"):
        fit_law(seen, family=own_family(Placeless), n_samples=0)


def test_a_failed_step_is_not_known():
    values = {"converged": np.array([1, 0]), "residual": np.zeros(2), "wall_time": np.zeros(2)}
    shares = np.array([[0.0, np.nan]] * 3)[..., None]
    preload = {"preload": np.array([1e6, 2e6])}
    result = with_load_shares(
        MACRO_RESULT.build(values | preload), shares, np.array([[1e6, 1e8, 2e8]])
    )
    np.testing.assert_array_equal(result["known"], [1, 0])


@pytest.mark.parametrize(
    ("below", "caution"), [(0.0, ""), (0.04, "4 % of the load lies below the pressures of the law")]
)
def test_load_near_the_data_is_a_caution_and_load_inside_is_not(below, caution):
    values = {"converged": [1], "residual": [0.0], "wall_time": [0.0], "preload": [1e6]}
    shares = np.array([below, 0.0, 0.0])[:, None, None]
    result = with_load_shares(MACRO_RESULT.build(values), shares, np.array([[1e6, 1e8, 2e8]]))
    assert caution in result.attrs["cautions"]
    assert bool(caution) == bool(result.attrs["cautions"])

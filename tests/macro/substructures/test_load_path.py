"""Closed cycles of shear at every preload: secant stiffness, slip and loss."""

import numpy as np
import pytest

from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro.bodies import stacked_blocks
from multiscale.macro.substructures import AssembledNewton, joint_path, load_joint
from multiscale.macro.substructures.load_path import closed_cycle, cycle_work

SIDE = 0.02  # m


def masing(amplitude, steps, stiffness=1e12, slip=2e-21):
    """Displacement of a closed cycle with the first loading tau / k + c tau^2."""

    def first(shear):
        return shear / stiffness + slip * shear**2

    shear = amplitude * np.append(1.0, closed_cycle(steps))
    down, up = shear[: 2 * steps + 1], shear[2 * steps + 1 :]
    back = first(amplitude) - 2.0 * first(0.5 * (amplitude - down))
    return np.append(back, -first(amplitude) + 2.0 * first(0.5 * (up + amplitude)))


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_the_work_is_exact_where_slip_grows_as_the_square_of_the_shear(steps):
    """Masing's loop dissipates 4/3 c tau^3, the third power of Mindlin at small amplitude."""
    amplitude = np.array([1e6, 3e6])
    loop = np.stack([masing(level, steps) for level in amplitude])
    np.testing.assert_allclose(cycle_work(amplitude, loop), 4.0 / 3.0 * 2e-21 * amplitude**3)


def test_the_work_of_an_elastic_cycle_exceeds_rounding():
    shear = 1e6 * np.append(1.0, closed_cycle(4))
    noise = 1.0 + 1e-13 * np.random.default_rng(seed=3).standard_normal(shear.size)
    assert cycle_work(1e6, shear / 1e13 * noise) == 0.0
    slip = 1e-6 * masing(1e6, 4) + shear / 1e13  # dissipates 1e-8 of the work and more
    assert cycle_work(1e6, slip) == pytest.approx(1e-6 * 4.0 / 3.0 * 2e-21 * 1e18, rel=1e-6)


@pytest.fixture(scope="module")
def blocks():
    law = Sliders(Exponential(1e9, 0.2e-6), 0.3, pressures=(1e6, 1e8), slabs=48)
    return stacked_blocks((SIDE, SIDE, SIDE), (4, 2, 1), [Elastic(210e9, 0.3)] * 2, [law])


def test_cycles_of_the_last_preload_equal_cycles_of_the_path(blocks):
    loading = joint_path((10e6, 20e6), 2e6, 1, 4, amplitudes=(0.5e6, 2e6))
    result = load_joint(blocks, loading, method=AssembledNewton())
    loss, secant = result["cycle_loss"].values, result["secant_stiffness"].values
    assert loss.shape == (2, 2)
    assert loss[1, 1] == pytest.approx(result["cycle_energy"].item(), rel=0.02)
    along, first = result["shear_displacement"].values, 2 + 4 - 1
    stiffness = 4e6 / (along[first] - along[first + 8])
    assert secant[1, 1] == pytest.approx(stiffness, rel=1e-3)
    assert result["cycle_slip"].values[1, 1] == pytest.approx(
        float(result["slipping_load"][-1]), rel=5e-3
    )
    assert np.all(np.diff(loss, axis=1) > 0.0)
    assert np.all(loss[0] > loss[1])  # a lighter preload slips and dissipates more
    assert np.all(np.diff(secant, axis=1) < 0.0)
    assert np.all(secant < result["tangential_stiffness"].values[:2, None])
    density = result["loss_density"].values @ result["point_area"].values
    np.testing.assert_allclose(density, loss)
    assert np.all(result["loss_density"].values >= 0.0)


@pytest.mark.slow
def test_a_cycle_beyond_friction_is_unknown_and_the_others_stay(blocks):
    loading = joint_path((2e6, 20e6), 1e6, 1, 2, amplitudes=(0.2e6, 1e6))
    result = load_joint(blocks, loading, method=AssembledNewton(), extrapolate=True)
    np.testing.assert_array_equal(np.isfinite(result["cycle_loss"]), [[True, False], [True, True]])
    text = result.attrs["cautions"]
    assert "cycles at the preload 2 MPa have no answer from the amplitude 1 MPa on" in text
    assert np.isfinite(result["cycle_energy"]).all()

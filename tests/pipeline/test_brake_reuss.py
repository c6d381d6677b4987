"""The Brake-Reuss beam against the published frequencies of its preloaded modes."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from multiscale.pipeline import load_case, run
from multiscale.pipeline.body_budget import Change
from multiscale.pipeline.stages.vibrating_bodies import _laws, _press
from multiscale.plotting import plot_vibrating_joint


def test_the_shipped_beam_has_its_asperities_and_modes():
    case = load_case("brake_reuss")
    (law,) = _laws(case.structure, case, [None], Change())
    assert law.asperities.density.sum() == pytest.approx(1371333.5)
    # by the reference implementation for the whole table of heights
    found = law.respond(np.array([[-1.5e-5], [0.0], [0.0]]), np.zeros((law.n_state, 1)))
    assert -found.traction[0, 0] == pytest.approx(15.079e6, rel=0.01)


@pytest.mark.slow
def test_a_quick_run_softens_and_damps_as_the_reference(tmp_path):
    """At the largest amplitude, less their values at the least: 7.02 % and 2.98 % there."""
    found = run(load_case("brake_reuss").quick(), tmp_path)["vibration"]
    assert found.sizes["node"] < 5000  # elements of first order
    softer = 1.0 - found["frequency"].values[-1] / found["frequency"].values[0]
    assert softer == pytest.approx(0.0702, rel=0.05)
    assert np.ptp(found["damping"].values) == pytest.approx(0.0298, rel=0.05)
    seen = plot_vibrating_joint(found, ax=Figure().add_subplot()).get_xlim()
    assert np.ptp(seen) == pytest.approx(1.1 * 121.412, rel=0.05)  # mm, the lap and not the beam


@pytest.mark.long
def test_the_preloaded_frequencies_are_those_of_the_reference():
    """J. H. Porter and M. R. W. Brake, data of tmdsimpy: flat interface, bending modes, Hz."""
    case = load_case("brake_reuss")
    asked = case.vibration.model_copy(update={"modes": (5,)})
    case = case.model_copy(update={"vibration": asked})
    still, _ = _press(case.structure, case, _laws(case.structure, case, [None], Change()))
    found = still.modes.frequency[[0, 2, 4]]
    np.testing.assert_allclose(found, [168.5026, 580.4082, 1177.6498], rtol=0.01)

"""The Brake-Reuss beam against the published frequencies of its preloaded modes."""

import numpy as np
import pytest

from multiscale.pipeline import load_case
from multiscale.pipeline.body_budget import Change
from multiscale.pipeline.stages.vibrating_bodies import _laws, _press


def test_the_shipped_beam_has_its_asperities_and_modes():
    case = load_case("brake_reuss")
    (law,) = _laws(case.structure, case, [None], Change())
    assert law.asperities.density.sum() == pytest.approx(1371333.5)
    # by the reference implementation for the whole table of heights
    found = law.respond(np.array([[-1.5e-5], [0.0], [0.0]]), np.zeros((law.n_state, 1)))
    assert -found.traction[0, 0] == pytest.approx(15.079e6, rel=0.01)


@pytest.mark.long
def test_the_preloaded_frequencies_are_those_of_the_reference():
    """J. H. Porter and M. R. W. Brake, data of tmdsimpy: flat interface, bending modes, Hz."""
    case = load_case("brake_reuss")
    still, _ = _press(case.structure, case, _laws(case.structure, case, [None], Change()))
    found = still.modes.frequency[[0, 2, 4]]
    np.testing.assert_allclose(found, [168.5026, 580.4082, 1177.6498], rtol=0.01)

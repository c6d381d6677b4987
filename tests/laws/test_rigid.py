"""Rigid contact with friction on search directions."""

import numpy as np
import pytest

from multiscale.laws import RigidContact


@pytest.mark.parametrize("second", [1.0, 1e-5, 1e5])
def test_rigid_contact_slides_against_its_traction_whatever_the_direction(second):
    rng = np.random.default_rng(seed=2)
    law, state = RigidContact(0.3), rng.normal(0, 1e-7, (2, 300))
    k = np.array([[1e13], [1e13], [second * 1e13]])
    source = rng.normal(0, 1e6, (3, 300)) * np.array([[1.0], [1.0], [max(1.0, second)]])
    jump = law.resolvent(source, k, state)
    traction, slip = source - k * jump, jump[1:] - state
    limit = -0.3 * traction[0]
    size, way = np.hypot(*traction[1:]), np.hypot(*slip)
    assert np.all(size <= limit + 1e-9 * np.abs(source).max())
    slides = (way > 1e-6 * way.max()) & (limit > 1e-2 * limit.max())
    assert 20 < np.count_nonzero(slides) < 280
    np.testing.assert_allclose(
        np.sum(traction[1:] * slip, 0)[slides], (size * way)[slides], rtol=1e-6
    )
    np.testing.assert_allclose(size[slides], limit[slides], rtol=1e-6)

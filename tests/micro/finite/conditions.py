"""Conditions that every state of a cell with friction satisfies."""

import numpy as np
import pytest


def check_contact(scene, state, load, mu, *, friction_error):
    """Check load, complementarity and Coulomb's bound; return pressure and tangential forces."""
    meeting = scene.meet(state.displacement, state.approach, state.slide)
    pressure = -np.sum(state.force * meeting.normal, axis=1)
    tangential = state.force + pressure[:, None] * meeting.normal
    scale = pressure.max()
    assert -state.force[:, 2].sum() == pytest.approx(load, rel=1e-8)
    assert np.all(pressure >= -1e-7 * scale)
    assert np.all(meeting.gap >= -1e-8)
    assert np.all(np.abs(meeting.gap[state.active]) < 1e-8)
    size = np.linalg.norm(tangential, axis=1)
    assert np.all(size <= mu * pressure + friction_error * scale)
    return pressure, tangential

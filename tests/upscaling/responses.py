"""Micro responses made by hand."""

import numpy as np

from multiscale.schema import MICRO_RESPONSE, branch_of

DECAY, SCALE = 0.45e-6, 4e8
PRESSURE = np.geomspace(5e6, 1e8, 8)


def response_of(gap, pressure=PRESSURE, *, area=None, converged=None, nominal=True, **attributes):
    """A micro response with the gaps (realisation, step)."""
    traction = np.zeros((*gap.shape, 3))
    traction[..., 0] = -pressure
    ones = np.ones(gap.shape, dtype=int)
    values = {
        "displacement_jump": np.zeros((*gap.shape, 3)),
        "traction": traction,
        "mean_gap": gap,
        "branch": branch_of(pressure),
        "contact_fraction": np.tile(pressure / 5e8, (len(gap), 1)) if area is None else area,
        "converged": ones if converged is None else converged,
        "active_set_iterations": ones,
        "linear_iterations": ones,
        "wall_time": 1.0 * ones,
    }
    if nominal:
        values["nominal_pressure"] = pressure
    return MICRO_RESPONSE.build(values, **attributes)


def exponential_gaps(n_realisations=1, spread=0.03, seed=1):
    """Gaps of an exponential law with one factor for each realisation."""
    random = np.random.default_rng(seed)
    u = DECAY * np.log(SCALE / PRESSURE)
    return u * (1.0 + spread * random.standard_normal((n_realisations, 1)))

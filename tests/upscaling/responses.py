"""Micro responses made by hand."""

import numpy as np

from multiscale.schema import MICRO_RESPONSE, SLIDING_RESPONSE, branch_of

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


def sheared_exponentials(
    decay, ratio, friction, pressures=(2e7, 8e7), *, steps=12, along=(0, 1), noise=None
):
    """A response of cells that are pressed, sheared along x and y until they slip, and released.

    Each cell follows the law of Jäger and Ciavarella on an exponential law with a decay length, a
    stiffness ratio along x and y and a separate friction coefficient.
    """
    decay, friction = (np.asarray(item, dtype=float)[:, None] for item in (decay, friction))
    rise = 8.0 * (np.arange(1, steps + 1) / steps) ** 2
    pressure, slip, traction = [], [], []
    for p in pressures:
        for axis in along:
            kappa = np.asarray(ratio)[:, axis, None]
            u = DECAY * np.mean(friction) / np.mean(kappa) * np.tile(rise, (len(decay), 1))
            t = friction * p * -np.expm1(-kappa * u / (friction * decay))
            if noise is not None:
                t = t * (1.0 + 0.01 * noise.standard_normal(t.shape))
            pressure += [p] * (steps + 1) + [0.0]
            for place, value in ((slip, u), (traction, t)):
                whole = np.zeros((len(decay), steps + 2, 2))
                whole[:, 1:-1, axis] = value
                place.append(whole)
    pressure = np.array(pressure)
    gaps = DECAY * np.log(SCALE / np.maximum(pressure, 1.0)) * np.ones((len(decay), 1))
    response = response_of(gaps, pressure)
    for name, value in (("displacement_jump", slip), ("traction", traction)):
        response[name].values[..., 1:] = np.concatenate(value, axis=1)
    sliding = np.concatenate([part.any(axis=2) for part in traction], axis=1)
    full = np.abs(np.concatenate(slip, axis=1)).sum(axis=2)
    full = full > 0.9 * full.max()
    return MICRO_RESPONSE.assign(response, {"slip_fraction": 1.0 * full + 0.5 * (sliding & ~full)})


def slid(steady, pressures=(0.008, 0.004)):
    """Two cells that slid under two pressures, of which only the steady friction is given."""
    shapes = {"load": 2, "step": 1, "component": 3}
    none = {
        name: np.zeros([shapes[dim] for dim in variable.dims])
        for name, variable in SLIDING_RESPONSE.variables.items()
    }
    lines = {"steady_friction": steady, "nominal_pressure": list(pressures)}
    return SLIDING_RESPONSE.build(none | lines)

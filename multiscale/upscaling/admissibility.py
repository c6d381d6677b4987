"""Check that a normal law is one: positive, decreasing and convex."""

import numpy as np

from multiscale.laws import NormalLaw

__all__ = ["is_admissible"]


def is_admissible(
    law: NormalLaw, pressure_range: tuple[float, float], *, n_points: int = 500
) -> bool:
    """Test a normal law at many gaps.

    Parameters
    ----------
    law : NormalLaw
        Any law with a pressure and a stiffness.
    pressure_range : tuple of float
        The law is tested between the gaps of these pressures, Pa, smallest first, and as far again
        to either side.
    n_points : int
        Number of gaps tested.

    Returns
    -------
    bool
        Whether pressure and stiffness are nowhere negative, the pressure never rises and the
        stiffness never rises with the gap, and no smaller than the secant: all up to 1e-9 of the
        largest value tested.
    """
    far, near = law.gap_at(np.array(pressure_range))
    gap = np.linspace(near - (far - near), far + (far - near), n_points)
    p, stiffness = law.pressure(gap), law.stiffness(gap)
    if not (np.all(np.isfinite(p)) and np.all(np.isfinite(stiffness))):
        return False
    secant = -np.diff(p) / np.diff(gap)
    slack_p, slack = 1e-9 * p.max(), 1e-9 * stiffness.max()
    return bool(
        np.all(p >= -slack_p)
        and np.all(stiffness[:-1] >= secant - slack)  # convex: the secant lies between
        and np.all(stiffness[1:] <= secant + slack)
        and np.all(stiffness >= -slack)
    )

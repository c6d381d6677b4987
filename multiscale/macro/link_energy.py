r"""Energy balance of a time step, summed link by link."""

from dataclasses import dataclass

import numpy as np

__all__ = ["EnergyStep", "account_links"]


@dataclass(frozen=True)
class EnergyStep:
    r"""Energy balance of a step, J.

    Attributes
    ----------
    kinetic, elastic : float, energies at the end of the step, J
    work : float, work of loads and moving supports, J
    numerical : float
        Dissipation by the scheme, :math:`(\theta - 1/2)\, \mathrm{d}v^T M\, \mathrm{d}v`, J.
    link : float, dissipation in the links, summed link by link, J
    smallest_link : float, smallest term of this sum, J
    """

    kinetic: float
    elastic: float
    work: float
    numerical: float
    link: float
    smallest_link: float


def account_links(
    mass: np.ndarray,
    velocity: tuple[np.ndarray, np.ndarray],
    elastic: tuple[np.ndarray, np.ndarray],
    tension: np.ndarray,
    growth: np.ndarray,
    work: float,
    theta: float,
) -> EnergyStep:
    r"""Return the energy balance of a step.

    Parameters
    ----------
    mass : ndarray, shape (n,), mass of each unknown, kg
    velocity : tuple of ndarray, shape (n,)
        Velocity at the end, and its change :math:`\mathrm{d}v` without impulses in the middle, m/s.
    elastic : tuple of ndarray, shape (rows,), energy of each link before and after, J
    tension : ndarray, shape (rows,)
        Mean tension of the step, N; for inextensible links impulse over step size.
    growth : ndarray, shape (rows,)
        :math:`\Delta e`, m; for impulses in the middle, the mean rate times the step.
    work : float, :math:`F_\theta \cdot \Delta u` and the work of moving supports, J
    theta : float, parameter of the scheme, from 1/2 to 1

    Notes
    -----
    From the equation of the step, with :math:`T` kinetic and :math:`V` elastic energy,

    .. math::
        \Delta T + \Delta V = W - (\theta - \tfrac12)\, \mathrm{d}v^T M\, \mathrm{d}v
        - \sum_l \left( \tau_l\, \Delta e_l - \Delta V_l \right);    \tag{1}

    with :func:`multiscale.macro.mean_tension.mean_tension`, or :math:`\theta = 1`, each term of
    the sum is at least zero because :math:`V_l` is convex.
    """
    after, change = velocity
    lost = tension * growth - (elastic[1] - elastic[0])
    return EnergyStep(
        kinetic=0.5 * float(after @ (mass * after)),
        elastic=float(np.sum(elastic[1])),
        work=work,
        numerical=(theta - 0.5) * float(change @ (mass * change)),
        link=float(np.sum(lost)),
        smallest_link=float(np.min(lost)),
    )

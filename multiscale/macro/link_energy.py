r"""Energy account of one time step, summed link by link."""

from dataclasses import dataclass

import numpy as np

__all__ = ["EnergyStep", "account_links"]


@dataclass(frozen=True)
class EnergyStep:
    r"""Where the energy of a step went, J.

    Attributes
    ----------
    kinetic, elastic : float
        At the end of the step.
    work : float
        Done by loads and moving supports.
    numerical : float
        Dissipated by the scheme, :math:`(\theta - 1/2)\, \mathrm{d}v^T M\, \mathrm{d}v`.
    link : float
        Dissipated in the links, summed link by link.
    smallest_link : float
        Smallest term of that sum.
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
    r"""Account for one step.

    Parameters
    ----------
    mass : ndarray, shape (n,)
        kg.
    velocity : tuple of ndarray, shape (n,)
        At the end, and its change :math:`\mathrm{d}v` but by impulses in the middle, m/s.
    elastic : tuple of ndarray, shape (rows,)
        Energy of each link before and after, J.
    tension : ndarray, shape (rows,)
        Mean of the step, N: impulse over step size.
    growth : ndarray, shape (rows,)
        :math:`\Delta e`, m; of impulses in the middle, the mean rate times the step.
    work : float
        :math:`F_\theta \cdot \Delta u` and the work of moving supports, J.
    theta : float
        Of the scheme.

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

"""Unilateral contact with Coulomb friction at nodes, and its derivative."""

from dataclasses import dataclass

import numpy as np

from multiscale.nonsmooth.semismooth_newton import linearise as linearise_space

__all__ = ["LocalLaw", "linearise"]


@dataclass(frozen=True)
class LocalLaw:
    """Residual of the contact law and its derivatives.

    Attributes
    ----------
    residual : ndarray, shape (nodes, c), Pa; zero where the law holds
    by_reaction : ndarray, shape (nodes, c, c), derivative by the reaction, dimensionless
    by_jump : ndarray, shape (nodes, c, c)
        Derivative by the jump, Pa/m. Zero rows where the node is open.
    """

    residual: np.ndarray
    by_reaction: np.ndarray
    by_jump: np.ndarray


def linearise(
    reaction: np.ndarray,
    jump: np.ndarray,
    friction: np.ndarray,
    stiffness: np.ndarray,
    kept: np.ndarray,
) -> LocalLaw:
    r"""Evaluate the law and a member of its generalised derivative.

    Notes
    -----
    With :math:`y = r - \rho\,(g, s)` and the ball of radius :math:`b = \mu \max(0, y_n)`,

    .. math:: R_n = r_n - \max(0, y_n), \qquad R_t = r_t - P_b(y_t),    \tag{1}

    which is (5) of the source with Coulomb's law: zero if and only if
    :math:`0 \le g \perp r_n \ge 0`, :math:`|r_t| \le \mu r_n`, and friction opposes slip.

    References
    ----------
    .. [1] P. Alart and A. Curnier, Comput. Methods Appl. Mech. Eng. 92 (1991) 353-375,
       doi:10.1016/0045-7825(91)90022-X.
    """
    c = reaction.shape[1]
    lost = ~kept
    lost[:, 1:] |= lost[:, :1] | (friction == 0.0)[:, None]
    space = np.zeros((2, len(reaction), 3))
    space[:, :, :c] = np.where(lost, 0.0, [stiffness[:, None] * jump, reaction])
    residual, by_jump, by_reaction = linearise_space(*space, friction)  # (1)
    return LocalLaw(
        np.where(lost, reaction, residual[:, :c]),
        np.where(lost[:, :, None], np.eye(c), by_reaction[:, :c, :c]),
        np.where(lost[:, :, None], 0.0, stiffness[:, None, None] * by_jump[:, :c, :c]),
    )

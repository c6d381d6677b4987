"""Unilateral contact with Coulomb friction at nodes, and its derivative."""

from dataclasses import dataclass

import numpy as np

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

    Parameters
    ----------
    reaction : ndarray, shape (nodes, c)
        :math:`r`, Pa: pressure and friction on side 2. One component without friction.
    jump : ndarray, shape (nodes, c)
        Gap :math:`g` and slip :math:`s` of the step, side 2 minus side 1, m.
    friction : ndarray, shape (nodes,), coefficient :math:`\mu`, dimensionless
    stiffness : ndarray, shape (nodes,)
        :math:`\rho > 0`, Pa/m; it changes the path of the iteration, not the solution.
    kept : ndarray of bool, shape (nodes, c)
        Components that can be transmitted; the others are zero.

    Returns
    -------
    LocalLaw, the residual and its derivatives

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
    nodes, c = reaction.shape
    y = reaction - stiffness[:, None] * jump
    closed = (y[:, 0] > 0.0) & kept[:, 0]
    residual = np.array(reaction)  # open: R = r
    by_reaction = np.broadcast_to(np.eye(c), (nodes, c, c)).copy()
    by_jump = np.zeros((nodes, c, c))

    residual[closed, 0] -= y[closed, 0]
    by_reaction[closed, 0, 0] = 0.0
    by_jump[closed, 0, 0] = stiffness[closed]
    if c == 1:
        return LocalLaw(residual, by_reaction, by_jump)

    y_t = np.where(kept[:, 1:], y[:, 1:], 0.0)
    size = np.linalg.norm(y_t, axis=1)
    bound = friction * np.maximum(y[:, 0], 0.0)
    stick = closed & (size <= bound) & (friction > 0.0)
    slip = closed & ~stick & (friction > 0.0)

    residual[stick, 1:] -= y_t[stick]
    e = y_t[slip] / size[slip, None]
    share = bound[slip] / size[slip]
    residual[slip, 1:] -= bound[slip, None] * e
    across = share[:, None, None] * (np.eye(c - 1) - e[:, :, None] * e[:, None, :])
    along = friction[slip, None] * e

    by_reaction[np.ix_(stick, range(1, c), range(1, c))] = 0.0
    by_jump[np.ix_(stick, range(1, c), range(1, c))] = stiffness[stick, None, None] * np.eye(c - 1)
    by_reaction[np.ix_(slip, range(1, c), range(1, c))] -= across
    by_reaction[slip, 1:, 0] = -along
    by_jump[np.ix_(slip, range(1, c), range(1, c))] = stiffness[slip, None, None] * across
    by_jump[slip, 1:, 0] = stiffness[slip, None] * along

    lost = ~kept
    by_reaction[lost] = np.broadcast_to(np.eye(c), (nodes, c, c))[lost]
    by_jump[lost] = 0.0
    by_jump[np.broadcast_to(lost[:, None, :], by_jump.shape)] = 0.0
    residual[lost] = reaction[lost]
    return LocalLaw(residual, by_reaction, by_jump)

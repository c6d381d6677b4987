"""Euclidean projection onto Coulomb's cone."""

import numpy as np

__all__ = ["project_friction_cone"]


def project_friction_cone(vector: np.ndarray, friction: np.ndarray | float) -> np.ndarray:
    r"""Projection onto Coulomb's cone, a second-order cone.

    Parameters
    ----------
    vector : ndarray, shape (d, ...), points, normal component first, in any unit
    friction : ndarray, shape (...), or float, friction coefficient :math:`\mu \ge 0`, dimensionless

    Returns
    -------
    ndarray, shape (d, ...), the nearest point of the cone

    Notes
    -----
    For :math:`K_\mu = \{x : \|x_T\| \le \mu x_N\}`,

    .. math::
        P(x) = x \text{ in } K_\mu, \qquad P(x) = 0 \text{ where } \mu \|x_T\| \le -x_N, \qquad
        P(x)_N = \frac{x_N + \mu \|x_T\|}{1 + \mu^2}, \quad
        P(x)_T = \mu P(x)_N \frac{x_T}{\|x_T\|} \text{ elsewhere.}    \tag{1}

    Examples
    --------
    >>> project_friction_cone(np.array([1.0, 3.0, 0.0]), friction=1.0)
    array([2., 2., 0.])
    """
    normal, tangent = vector[0], vector[1:]
    length = np.sqrt(np.sum(tangent**2, axis=0))
    inside = (normal >= 0.0) & (length <= friction * normal)  # also where friction is zero
    outside = ~inside & (friction * length <= -normal)
    height = np.where(outside, 0.0, (normal + friction * length) / (1.0 + np.square(friction)))
    shrink = friction * height / np.where(length > 0.0, length, 1.0)
    surface = np.concatenate([height[None], shrink * tangent])
    return np.asarray(np.where(inside, vector, surface))  # (1)

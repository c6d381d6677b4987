"""A half-space with a periodic profile, pressed against a plane through an interface law.

The stiffness of a half-space is a full matrix without bodies of elements: it goes to
:func:`solve_interface` as it is, and no assembly is made.
"""

import numpy as np
from scipy.linalg import circulant
from scipy.sparse import eye_array

from multiscale.convergence import Solution
from multiscale.errors import CaseError
from multiscale.laws.interface_law import NormalLaw
from multiscale.macro.monolithic import solve_interface

__all__ = ["half_space_stiffness", "press_profile"]


def half_space_stiffness(points: int, length: float, contact_modulus: float) -> np.ndarray:
    r"""Return the stiffness of the surface of a half-space for periodic displacement, plane strain.

    Parameters
    ----------
    points : int, number of equidistant points in a period
    length : float, period, m
    contact_modulus : float, :math:`E^*`, Pa

    Returns
    -------
    ndarray, shape (points, points)
        Force on a point per displacement of a point, Pa (N/m per metre of width). The stiffness of
        a wave is :math:`E^* |q| / 2` per area; the mean displacement has no stiffness.
    """
    q = 2.0 * np.pi * np.abs(np.fft.fftfreq(points, length / points))
    return np.asarray(circulant(np.fft.ifft(0.5 * contact_modulus * q).real) * (length / points))


def press_profile(
    initial_gap: np.ndarray,
    length: float,
    contact_modulus: float,
    pressure: float,
    law: NormalLaw,
    *,
    max_iterations: int = 100,
    tolerance: float = 1e-9,
) -> Solution:
    r"""Find the gaps of a profile under a mean pressure.

    Parameters
    ----------
    initial_gap : ndarray, shape (points,)
        Distance :math:`g_0` of the mean planes of the roughness before deformation, at equidistant
        points of a period, m; an added constant has no effect.
    length : float, period, m
    contact_modulus : float, :math:`E^*` of both bodies, Pa
    pressure : float, nominal pressure :math:`p`, Pa
    law : NormalLaw, law of the roughness that the profile does not resolve
    max_iterations, tolerance
        See :func:`~multiscale.macro.monolithic.solve_interface`.

    Returns
    -------
    Solution, ``value`` is the local gap :math:`g`, shape (points,), m

    Raises
    ------
    CaseError
        If the pressure is not positive.

    Notes
    -----
    The displacement of the surface is :math:`g - g_0` up to a constant, so that with the stiffness
    K of :func:`half_space_stiffness` and the weights :math:`w`

    .. math:: K (g - g_0) + w\,t(g) = -w\,p,    \tag{1}

    with the traction :math:`t` of the law: the gap is both the unknown and the jump.
    """
    if not 0.0 < pressure < np.inf:
        raise CaseError(f"the nominal pressure must be positive and finite (Pa), got {pressure:g}")
    n = initial_gap.size
    K = half_space_stiffness(n, length, contact_modulus)
    weight = np.full(n, length / n)
    closed = np.full(n, float(law.gap_at(np.array(pressure))) - law.gap)
    return solve_interface(
        K,
        K @ initial_gap - weight * pressure,
        eye_array(n, format="csr"),
        weight,
        law,
        start=closed,
        max_iterations=max_iterations,
        tolerance=tolerance,
    )

"""Coulomb's law as equations of contact vectors (d, contacts), normal in row 0; its verifier."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from scipy.sparse import csr_array

from multiscale.convergence import check_limits

ORDINARY = 1e50
"""Numbers between this and its inverse have powers that neither underflow nor overflow."""

ROUND_OFF = 64.0 * np.finfo(float).eps
"""Round-off of a reaction with a number far above the number of the velocity."""


def project_friction_cone(vector: np.ndarray, friction: np.ndarray | float) -> np.ndarray:
    r"""Projection onto Coulomb's cone :math:`K_\mu = \{x : \|x_T\| \le \mu x_N\}`."""
    normal, tangent = vector[0], vector[1:]
    length = np.sqrt(np.sum(tangent**2, axis=0))
    inside = (normal >= 0.0) & (length <= friction * normal)  # also where friction is zero
    outside = ~inside & (friction * length <= -normal)
    height = np.where(outside, 0.0, (normal + friction * length) / (1.0 + np.square(friction)))
    shrink = friction * height / np.where(length > 0.0, length, 1.0)
    surface = np.concatenate([height[None], shrink * tangent])
    return np.asarray(np.where(inside, vector, surface))  # (1)


def shifted_velocity(velocity: np.ndarray, friction: np.ndarray) -> np.ndarray:
    r"""De Saxcé's velocity :math:`\tilde u = u + \mu \|u_T\| n`, shape (d, contacts), m/s."""
    shifted = np.array(velocity, dtype=float)
    shifted[0] += friction * np.sqrt(np.sum(shifted[1:] ** 2, axis=0))
    return shifted


def natural_map(
    velocity: np.ndarray, reaction: np.ndarray, friction: np.ndarray, step: np.ndarray | float = 1.0
) -> np.ndarray:
    r"""Residual (1) :math:`r - P_{K_\mu}(r - \rho\,(u + \mu \|u_T\| n))` of Coulomb's law."""
    # V. Acary, F. Cadoux, C. Lemaréchal and J. Malick, Z. Angew. Math. Mech. 91 (2011) 155-175,
    # doi:10.1002/zamm.201000073
    ahead = reaction - step * shifted_velocity(velocity, friction)
    return np.asarray(reaction - project_friction_cone(ahead, friction))  # (1)


@dataclass(frozen=True)
class Verdict:
    """Errors of an answer, measured from the data only; every number is dimensionless."""

    error: float  # natural-map error relative to the norm of the data, the larger of (1)
    penetration: float  # largest approach left at a contact, relative to the norm of the data
    cone_violation: float  # largest distance of an impulse from its cone over the largest impulse
    tolerance: float  # upper bound of each of the three numbers

    @property
    def accepted(self) -> bool:
        """Whether every number is finite and within the tolerance."""
        return self.residual <= self.tolerance  # a NaN compares false

    @property
    def residual(self) -> float:
        """The largest of the three numbers, NaN if any of them is NaN."""
        return float(np.max((self.error, self.penetration, self.cone_violation)))


def verify_friction(
    delassus: csr_array | np.ndarray,
    velocity: np.ndarray,
    friction: np.ndarray,
    reaction: np.ndarray,
    *,
    tolerance: float = 1e-8,
) -> Verdict:
    r"""Check an answer of a friction problem from the data only.

    Parameters
    ----------
    delassus : csr_array or ndarray, shape (d * contacts, d * contacts), :math:`W`, 1/kg
    velocity : ndarray, shape (d * contacts,)
        :math:`q`, the relative velocity without contact impulses, m/s.
    friction : ndarray, shape (contacts,), :math:`\mu`, dimensionless
    reaction : ndarray, shape (d * contacts,), the answer :math:`r`, N s
    tolerance : float, bound on every number of the verdict; dimensionless

    Returns
    -------
    Verdict, with ``accepted`` true if all numbers are within the tolerance

    Notes
    -----
    With :math:`u = W r + q`, the natural map is measured twice: with :math:`\rho = 1`, the
    number that other codes report, and with the mass :math:`\rho_i = d / \mathrm{tr} W_{ii}` of
    the contact and divided by it, a velocity that no choice of units can hide:

    .. math::
        \max\Bigl( \|F_1\|, \ \bigl\|\rho^{-1} F_\rho\bigr\| \Bigr) \le
        \mathrm{tolerance} \, \|q\|.    \tag{1}

    All numbers are computed in the units of :func:`natural_units`, without under- and overflow.
    """
    check_limits(tolerance)
    contacts = np.size(friction)
    mobility, speed = natural_units(delassus, np.reshape(velocity, (contacts, -1)))
    with np.errstate(all="ignore"):  # overflow is not finite, and not accepted
        W, q = delassus / mobility, np.asarray(velocity) / speed
        r = (np.asarray(reaction, dtype=float) / speed * mobility).reshape(contacts, -1).T
        u = np.asarray(W @ r.T.ravel() + q).reshape(r.T.shape).T
    if not np.all(np.isfinite(r)) or not np.all(np.isfinite(u)):
        return Verdict(np.inf, np.inf, np.inf, tolerance)
    scale = closing_norm(q.reshape(contacts, -1))

    step, unit = contact_mass(W.diagonal().reshape(contacts, -1)), unit_step(mobility)
    error = law_error(u, r, friction, step, unit)
    outside = norm(r - project_friction_cone(r, friction), axis=0)
    return Verdict(
        error=error / scale,
        penetration=max(0.0, -float(u[0].min(initial=0.0))) / scale,
        cone_violation=float(outside.max(initial=0.0)) / (float(np.abs(r).max(initial=0.0)) or 1.0),
        tolerance=tolerance,
    )


def law_error(
    velocity: np.ndarray, reaction: np.ndarray, friction: np.ndarray, mass: np.ndarray, unit: float
) -> float:
    """Larger number of (1) of :func:`verify_friction`, less the rounding of the other, m/s."""
    weighted = norm(natural_map(velocity, reaction, friction, mass) / mass)
    plain = norm(natural_map(velocity, reaction, friction, unit)) - ROUND_OFF * norm(reaction)
    return max(float(weighted), float(plain) / unit)


def natural_units(delassus: csr_array | np.ndarray, velocity: np.ndarray) -> tuple[float, float]:
    """Units in which no power underflows: of mobility and closing velocity, powers of two."""
    closing = np.abs(velocity[velocity[:, 0] < 0.0])
    speed = float(closing.max(initial=0.0)) or float(np.abs(velocity).max(initial=0.0))
    mobility = float(np.abs(delassus.diagonal()).max(initial=0.0))
    return _power_of_two(mobility), _power_of_two(speed)


def unit_step(mobility: float) -> float:
    """Step of 1 kg in natural units, within the range in which the natural map changes."""
    return float(np.clip(mobility, 1e-100, 1e100))


def _power_of_two(value: float) -> float:
    """Largest power of two that is not above a value; 1 for zero and for ordinary numbers."""
    if value == 0.0 or 1.0 / ORDINARY < value < ORDINARY:
        return 1.0
    return float(np.ldexp(1.0, np.frexp(value)[1] - 1))


def closing_norm(velocity: np.ndarray) -> float:
    """Norm of q over the closing contacts, m/s; over all contacts if none closes."""
    closing = velocity[velocity[:, 0] < 0.0]
    return float(norm(closing)) or float(norm(velocity)) or 1.0


def contact_mass(diagonal: np.ndarray) -> np.ndarray:
    """Effective mass of each contact, kg, from the diagonal of W, shape (contacts, d), 1/kg."""
    mean = np.mean(np.abs(diagonal), axis=1)
    return np.asarray(1.0 / np.where(mean > 0.0, mean, float(np.max(mean, initial=0.0)) or 1.0))

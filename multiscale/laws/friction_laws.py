"""Friction: coefficients over pressure and speed, steady sliding, and rigid unilateral contact."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.laws.interface_law import InterfaceLaw, NormalLaw, Response, check_parameters

LEAST_RATIO = 1e-150
"""Least pressure and speed of a bell, relative to the pressure and speed of its peak."""

DIFFERENCE_STEP = 1e-6  # step of central differences by the pressure, relative to it

MAX_ITERATIONS, RELATIVE_CHANGE = 60, 1e-15
"""Iteration limit of Newton's method, and the relative change at which it stops."""

NEGLIGIBLE_LIMIT, LEAST_DIVISOR = 1e-14, 1e-150
"""Limit below which the traction is zero, relative to the unlimited traction; least divisor."""


class FrictionLaw(ABC):
    r"""Isotropic friction: a coefficient defines the traction along the sliding velocity.

    With the velocity :math:`v` of side 2 against side 1,

    .. math:: t_T = \mu(p, |v|)\, p\, v / |v|,    \tag{1}

    which dissipates for :math:`\mu \ge 0`; work-conjugate to the jump.
    """

    @abstractmethod
    def coefficient(self, pressure: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Return the friction coefficient, dimensionless, at pressures, Pa, and speeds, m/s."""

    def traction(self, pressure: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Evaluate (1), Pa, for a sliding velocity of shape (d - 1, ...), m/s; zero at rest."""
        velocity = np.asarray(velocity, dtype=float)
        speed = np.linalg.norm(velocity, axis=0)
        direction = velocity / np.where(speed > 0.0, speed, 1.0)
        return np.asarray(self.coefficient(pressure, speed) * pressure * direction)


@dataclass(frozen=True)
class Coulomb(FrictionLaw):
    r"""Coulomb's law with a constant friction coefficient.

    Parameters
    ----------
    friction_coefficient : float, coefficient :math:`\mu \ge 0`, dimensionless
    """

    friction_coefficient: float

    def __post_init__(self) -> None:
        check_parameters(self, lowest=0.0, friction_coefficient="1")

    def coefficient(self, pressure: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Return the constant coefficient in the common shape of the arguments."""
        mu = np.broadcast_arrays(self.friction_coefficient, pressure, speed)[0]
        return np.array(mu, dtype=float)


@dataclass(frozen=True)
class DecayingFriction(FrictionLaw):
    r"""Friction coefficient that decays exponentially with the speed, from static to kinetic.

    Parameters
    ----------
    static_coefficient, kinetic_coefficient : float
        Coefficients :math:`\mu_s \ge 0` at rest and :math:`\mu_k \ge 0` at high speed,
        dimensionless.
    decay_speed : float, speed :math:`v_c > 0` of the decay, m/s

    Notes
    -----
    .. math:: \mu(v) = \mu_k + (\mu_s - \mu_k)\, e^{-v / v_c}.    \tag{2}
    """

    static_coefficient: float
    kinetic_coefficient: float
    decay_speed: float

    def __post_init__(self) -> None:
        check_parameters(self, lowest=0.0, static_coefficient="1", kinetic_coefficient="1")
        check_parameters(self, decay_speed="m/s")

    def coefficient(self, pressure: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Evaluate (2)."""
        speed = np.broadcast_arrays(np.asarray(speed, dtype=float), pressure)[0]
        change = self.static_coefficient - self.kinetic_coefficient
        return np.asarray(self.kinetic_coefficient + change * np.exp(-speed / self.decay_speed))


@dataclass(frozen=True)
class BellFriction(FrictionLaw):
    r"""Rubber friction: a bell over the logarithm of the speed that depends on the pressure.

    Parameters
    ----------
    peak_coefficient : float
        Coefficient :math:`\mu_m \ge 0` at peak speed and reference pressure, dimensionless.
    peak_speed : float, speed :math:`v_m > 0` of the peak at the reference pressure, m/s
    rise_exponent, fall_exponent : float
        Powers :math:`r, f > 0` of the speed far below and far above the peak, dimensionless.
    pressure_exponent : float
        Exponent :math:`a`, negative if friction decreases with the pressure, dimensionless.
    speed_exponent : float
        Exponent :math:`c`, positive if the speed of the peak increases with the pressure,
        dimensionless.
    reference_pressure : float, pressure :math:`p_0 > 0`, Pa

    Notes
    -----
    .. math::
        \mu(p, v) = \mu_m \Big(\frac{p}{p_0}\Big)^a
        \frac{r + f}{f\, e^{-r x} + r\, e^{f x}}, \qquad
        x = \ln \frac{v}{v_m\, (p/p_0)^c}.    \tag{3}

    A single relaxation time gives :math:`r = f = 1`, a spectrum a wider bell with different flanks.
    Contact spots grow with the pressure, so that the same frequency belongs to a higher speed.
    Coefficients computed for rubber on rough ground depend on speed and pressure like this [1]_.

    References
    ----------
    .. [1] L. De Lorenzis and P. Wriggers, Comput. Mater. Sci. 77 (2013) 243-252,
       doi:10.1016/j.commatsci.2013.04.049.
    """

    peak_coefficient: float
    peak_speed: float
    rise_exponent: float
    fall_exponent: float
    pressure_exponent: float
    speed_exponent: float
    reference_pressure: float

    def __post_init__(self) -> None:
        check_parameters(self, lowest=0.0, peak_coefficient="1")
        check_parameters(self, rise_exponent="1", fall_exponent="1")
        check_parameters(self, peak_speed="m/s", reference_pressure="Pa")
        for name in ("pressure_exponent", "speed_exponent"):
            if not np.all(np.isfinite(getattr(self, name))):
                raise CaseError(f"{name} must be finite, got {getattr(self, name)}")

    def coefficient(self, pressure: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Evaluate (3); finite at zero pressure and zero speed."""
        load = np.maximum(np.asarray(pressure, dtype=float) / self.reference_pressure, LEAST_RATIO)
        pace = np.maximum(np.asarray(speed, dtype=float) / self.peak_speed, LEAST_RATIO)
        x = np.log(pace) - self.speed_exponent * np.log(load)
        r, f = self.rise_exponent, self.fall_exponent
        bell = np.exp(np.log(r + f) - np.logaddexp(np.log(f) - r * x, np.log(r) + f * x))
        return np.asarray(self.peak_coefficient * load**self.pressure_exponent * bell)


def wlf_shift(temperature: float, reference: float, c1: float = 17.44, c2: float = 51.6) -> float:
    r"""Return the shift factor of relaxation times by Williams, Landel and Ferry [1]_.

    .. math:: \log_{10} a_T = -\frac{c_1 (T - T_r)}{c_2 + T - T_r}

    Parameters
    ----------
    temperature, reference : float, temperature :math:`T` and reference temperature :math:`T_r`, K
    c1, c2 : float
        Constants :math:`c_1`, dimensionless, and :math:`c_2`, K; the defaults hold for many
        polymers with the glass transition as reference.

    Returns
    -------
    float, ratio :math:`a_T` of the relaxation times at T and at the reference, dimensionless

    References
    ----------
    .. [1] J. Am. Chem. Soc. 77 (1955) 3701-3707, doi:10.1021/ja01619a008.

    Examples
    --------
    >>> wlf_shift(293.0, 293.0)
    1.0
    """
    above = temperature - reference
    if not c2 + above > 0.0:
        raise CaseError(
            f"the shift factor is not defined at {temperature:g} K, {-above:g} K below its "
            f"reference; stay less than {c2:g} K below it"
        )
    return float(10.0 ** (-c1 * above / (c2 + above)))


@dataclass(frozen=True)
class SteadySliding(InterfaceLaw):
    r"""Interface law of steady sliding with the same velocity at all points.

    Parameters
    ----------
    normal : NormalLaw, law of the pressure, with the initial gap
    velocity : tuple of float
        Velocity :math:`v` of side 2 relative to side 1 along each tangent, m/s, not zero.

    Notes
    -----
    .. math:: t_N = -p(g), \qquad t_T = \mu(p, |v|)\, p\, \frac{v}{|v|}.    \tag{1}

    The tangent is not symmetric; the derivative of :math:`\mu p` is a central difference.
    """

    normal: NormalLaw
    friction: FrictionLaw
    velocity: tuple[float, ...]

    def __post_init__(self) -> None:
        if not 0.0 < float(np.linalg.norm(self.velocity)) < np.inf:
            raise CaseError(f"the velocity must be finite and not zero (m/s), got {self.velocity}")

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Evaluate (1) and its derivative."""
        pressed = self.normal.respond(jump, state)
        p = -pressed.traction[0]
        direction = np.array(self.velocity) / np.linalg.norm(self.velocity)
        slope = (
            self.friction_limit(p * (1.0 + DIFFERENCE_STEP))
            - self.friction_limit(p * (1.0 - DIFFERENCE_STEP))
        ) / (2.0 * DIFFERENCE_STEP)
        slope = np.divide(slope, p, out=np.zeros_like(p), where=p > 0.0)
        traction, tangent = pressed.traction.copy(), pressed.tangent.copy()
        for k, share in enumerate(direction, start=1):
            traction[k] = share * self.friction_limit(p)  # (1)
            tangent[k, 0] = -share * slope * pressed.tangent[0, 0]
        return Response(traction, tangent, state)

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Solve the normal row, then the friction that its pressure determines."""
        k = np.broadcast_to(stiffness, source.shape)
        jump = self.normal.resolvent(source, k, state)
        jump[1:] -= self.respond(jump, state).traction[1:] / k[1:]
        return jump

    def friction_limit(self, pressure: np.ndarray) -> np.ndarray:
        """Evaluate mu p, Pa; zero without pressure."""
        closed = pressure > 0.0
        p = np.where(closed, pressure, 1.0)
        speed = np.full(p.shape, float(np.linalg.norm(self.velocity)))
        return np.where(closed, self.friction.coefficient(p, speed) * p, 0.0)


@dataclass(frozen=True)
class RigidContact(InterfaceLaw):
    r"""Unilateral contact without penetration and adhesion, with Coulomb friction.

    Parameters
    ----------
    friction : float, friction coefficient :math:`\mu \ge 0`, dimensionless
    gap : float, default 0.0, initial gap :math:`g_0`, m

    Notes
    -----
    With the gap :math:`g = [\![u_N]\!] + g_0` and the slip :math:`s` of the step, the change of
    :math:`[\![u_T]\!]`,

    .. math::
        0 \le g \perp p = -t_N \ge 0, \qquad |t_T| \le \mu p, \qquad
        s = \lambda\, t_T, \quad 0 \le \lambda \perp \mu p - |t_T| \ge 0,    \tag{1}

    the inequalities of (4) of the source. The jump does not determine the traction of a closed
    point: :meth:`respond` returns NaN there, and only solvers that use the resolvent, such as
    :func:`multiscale.macro.solve_latin`, accept this law. The state is the tangential jump of the
    last step, m.
    """

    friction: float = 0.0
    gap: float = 0.0

    n_state, compliant = 2, False

    def __post_init__(self) -> None:
        require("friction", self.friction, "[0, inf)")
        if not np.isfinite(self.gap):
            raise CaseError(f"the initial gap must be finite (m), got {self.gap:g}")

    def friction_limit(self, pressure: np.ndarray) -> np.ndarray:
        """Return Coulomb's limit, Pa, at a pressure, Pa."""
        return self.friction * pressure

    def from_here(self, state: np.ndarray) -> np.ndarray:
        """Return the state of no tangential jump."""
        return np.zeros_like(state)

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Return zero traction at open points, NaN at closed points, and the new state."""
        apart = np.where(jump[0] + self.gap > 0.0, 0.0, np.nan)
        return Response(apart + np.zeros_like(jump), apart + np.zeros((3, *jump.shape)), jump[1:])

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Solve (1) and t + k [u] = source for the jump; see :func:`limit_traction`."""
        k = np.broadcast_to(stiffness, source.shape)
        if not np.all(k > 0.0):
            raise ValueError("the stiffness of a search direction must be positive (Pa/m)")
        pressure = np.maximum(0.0, -source[0] - k[0] * self.gap)
        sticking = source[1:] - k[1:] * state  # traction that prevents slip
        limit = self.friction_limit(pressure)
        traction = limit_traction(sticking / k[1:], 1.0 / k[1:], limit)
        slides = np.sqrt(np.sum(sticking**2, axis=0)) > limit
        slip = np.where(slides, (sticking - traction) / k[1:], 0.0)
        normal = np.where(pressure > 0.0, -self.gap, source[0] / k[0])
        return np.stack([normal, *(state + slip)])


def limit_traction(drive: np.ndarray, softness: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return the tangential traction on a search direction, no larger than a limit."""
    sigma = np.zeros(limit.shape)
    for _ in range(MAX_ITERATIONS):
        # t_i = d_i / (sigma + a_i), |t| <= limit (1), by Newton's method for 1/|t| = 1/limit, which
        # is monotone: J. J. Moré, D. C. Sorensen, SIAM J. Sci. Stat. Comput. 4 (1983) 553-572,
        # doi:10.1137/0904038
        traction = drive / np.maximum(sigma + softness, LEAST_DIVISOR)  # (1)
        size = np.sqrt(np.sum(traction**2, axis=0))
        slides = (size > limit) & (limit > NEGLIGIBLE_LIMIT * size)
        along = traction / np.maximum(size, LEAST_DIVISOR)
        slope = np.sum(along**2 / np.maximum(sigma + softness, LEAST_DIVISOR), axis=0)
        rise = np.where(slides, size / np.where(slides, limit, 1.0) - 1.0, 0.0)
        step = rise / np.where(slides, slope, 1.0)
        if not np.any(step > RELATIVE_CHANGE * sigma):
            break
        sigma = sigma + step
    return np.asarray(along * np.minimum(size, limit))

"""Friction laws of interfaces that depend on pressure and sliding speed."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.parameters import check_parameter

__all__ = ["BellFriction", "Coulomb", "DecayingFriction", "FrictionLaw"]

LEAST_RATIO = 1e-150
"""Least pressure and speed of a bell, relative to the pressure and speed of its peak."""


class FrictionLaw(ABC):
    r"""Isotropic friction: a coefficient defines the traction along the sliding velocity.

    With the velocity :math:`v` of side 2 against side 1,

    .. math:: t_T = \mu(p, |v|)\, p\, v / |v|,    \tag{1}

    which dissipates, :math:`t_T \cdot v = \mu\, p\, |v| \ge 0` for :math:`\mu \ge 0`, and is
    independent of the frame of the tangent plane. The traction is work-conjugate to the jump; the
    opposite traction acts on side 2.
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

    Raises
    ------
    CaseError
        If the coefficient is negative or not finite.

    Examples
    --------
    >>> Coulomb(0.3).traction(np.array(1.0e6), np.array([0.0, -2.0]))  # Pa
    array([      0., -300000.])
    """

    friction_coefficient: float

    def __post_init__(self) -> None:
        check_parameter(self, "friction_coefficient", lowest=0.0)

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

    Raises
    ------
    CaseError
        If a parameter is outside its range.

    Notes
    -----
    .. math:: \mu(v) = \mu_k + (\mu_s - \mu_k)\, e^{-v / v_c}.    \tag{2}

    Examples
    --------
    >>> law = DecayingFriction(static_coefficient=0.5, kinetic_coefficient=0.2, decay_speed=0.1)
    >>> law.coefficient(np.array(1.0e6), np.array([0.0, 10.0]))
    array([0.5, 0.2])
    """

    static_coefficient: float
    kinetic_coefficient: float
    decay_speed: float

    def __post_init__(self) -> None:
        check_parameter(self, "static_coefficient", lowest=0.0)
        check_parameter(self, "kinetic_coefficient", lowest=0.0)
        check_parameter(self, "decay_speed", "m/s")

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

    Raises
    ------
    CaseError
        If a parameter is outside its range.

    Notes
    -----
    .. math::
        \mu(p, v) = \mu_m \Big(\frac{p}{p_0}\Big)^a
        \frac{r + f}{f\, e^{-r x} + r\, e^{f x}}, \qquad
        x = \ln \frac{v}{v_m\, (p/p_0)^c}.    \tag{3}

    The loss of a body with one relaxation time has :math:`r = f = 1`; a spectrum of times gives a
    wider bell, whose flanks may differ. Contact spots grow with the pressure, so that the
    same frequency belongs to a higher speed. Coefficients computed for rubber on rough ground
    increase and decrease with the speed and depend on the pressure [1]_.

    References
    ----------
    .. [1] L. De Lorenzis and P. Wriggers, Comput. Mater. Sci. 77 (2013) 243-252,
       doi:10.1016/j.commatsci.2013.04.049.

    Examples
    --------
    >>> law = BellFriction(1.2, 0.01, 1.0, 1.0, -0.2, 0.5, 1.0e5)
    >>> law.coefficient(np.array(1.0e5), np.array([0.0, 0.005, 0.01, 0.02])).round(3)
    array([0.  , 0.96, 1.2 , 0.96])
    """

    peak_coefficient: float
    peak_speed: float
    rise_exponent: float
    fall_exponent: float
    pressure_exponent: float
    speed_exponent: float
    reference_pressure: float

    def __post_init__(self) -> None:
        check_parameter(self, "peak_coefficient", lowest=0.0)
        for name in ("rise_exponent", "fall_exponent"):
            check_parameter(self, name)
        for name, unit in (("peak_speed", "m/s"), ("reference_pressure", "Pa")):
            check_parameter(self, name, unit)
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

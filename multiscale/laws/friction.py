"""Friction of an interface that depends on pressure and sliding velocity."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.parameters import check_parameter

__all__ = ["BellFriction", "Coulomb", "DecayingFriction", "FrictionLaw"]


class FrictionLaw(ABC):
    r"""Isotropic friction: a coefficient gives the traction along the sliding velocity.

    With the velocity :math:`v` of side 2 against side 1,

    .. math:: t_T = \mu(p, |v|)\, p\, v / |v|,    \tag{1}

    which never supplies energy, :math:`t_T \cdot v = \mu\, p\, |v| \ge 0` for
    :math:`\mu \ge 0`, and turns with the frame of the tangent plane. It is the traction that is
    work-conjugate to the jump: side 2 feels its opposite.
    """

    @abstractmethod
    def coefficient(self, pressure: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Friction coefficient, dimensionless, at pressures, Pa, and speeds, m/s."""

    def traction(self, pressure: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Evaluate (1), Pa, for a sliding velocity of shape (d - 1, ...), m/s; zero at rest."""
        velocity = np.asarray(velocity, dtype=float)
        speed = np.linalg.norm(velocity, axis=0)
        direction = velocity / np.where(speed > 0.0, speed, 1.0)
        return np.asarray(self.coefficient(pressure, speed) * pressure * direction)


@dataclass(frozen=True)
class Coulomb(FrictionLaw):
    r"""Coulomb's law: one friction coefficient.

    Parameters
    ----------
    friction_coefficient : float
        :math:`\mu \ge 0`, dimensionless.

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
        """Return the constant, in the common shape of the arguments."""
        mu = np.broadcast_arrays(self.friction_coefficient, pressure, speed)[0]
        return np.array(mu, dtype=float)


@dataclass(frozen=True)
class DecayingFriction(FrictionLaw):
    r"""Friction that decays from a static to a kinetic coefficient as the interface speeds up.

    Parameters
    ----------
    static_coefficient, kinetic_coefficient : float
        :math:`\mu_s \ge 0` at rest and :math:`\mu_k \ge 0` at high speed, dimensionless.
    decay_speed : float
        :math:`v_c > 0`, m/s.

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
    r"""Friction of rubber: a power of the pressure times a bell over the logarithm of the speed.

    Parameters
    ----------
    peak_coefficient : float
        :math:`\mu_m \ge 0` at the peak speed and the reference pressure, dimensionless.
    rest_share : float
        :math:`0 \le r \le 1`, the share of it far from the peak speed, dimensionless.
    peak_speed : float
        :math:`v_m > 0`, m/s.
    width : float
        :math:`w > 0` of the bell, in natural logarithms of the speed, dimensionless.
    pressure_exponent : float
        :math:`a`; negative where friction falls with the pressure, dimensionless.
    reference_pressure : float
        :math:`p_0 > 0`, Pa.

    Raises
    ------
    CaseError
        If a parameter is outside its range.

    Notes
    -----
    .. math::
        \mu(p, v) = \mu_m \Big(\frac{p}{p_0}\Big)^a
        \Big( r + (1 - r)\, e^{-\ln^2(v / v_m) / w^2} \Big).    \tag{3}

    Coefficients computed for rubber on rough ground rise and fall over the velocity in this way and
    depend on the pressure [1]_.

    References
    ----------
    .. [1] L. De Lorenzis and P. Wriggers, Comput. Mater. Sci. 77 (2013) 243-252,
       doi:10.1016/j.commatsci.2013.04.049.

    Examples
    --------
    >>> law = BellFriction(1.2, 0.4, 0.01, 3.0, -0.2, 1.0e5)
    >>> law.coefficient(np.array(1.0e5), np.array([0.0, 0.01]))
    array([0.48, 1.2 ])
    """

    peak_coefficient: float
    rest_share: float
    peak_speed: float
    width: float
    pressure_exponent: float
    reference_pressure: float

    def __post_init__(self) -> None:
        for name in ("peak_coefficient", "rest_share"):
            check_parameter(self, name, lowest=0.0)
        for name, unit in (("peak_speed", "m/s"), ("width", "1"), ("reference_pressure", "Pa")):
            check_parameter(self, name, unit)
        if not np.all(np.asarray(self.rest_share) <= 1.0):
            raise CaseError(f"rest_share must be at most 1, got {np.max(self.rest_share):g}")
        if not np.all(np.isfinite(self.pressure_exponent)):
            raise CaseError(f"pressure_exponent must be finite, got {self.pressure_exponent}")

    def coefficient(self, pressure: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Evaluate (3); zero pressure and zero speed included where (3) has a limit."""
        with np.errstate(divide="ignore"):
            decades = np.log(np.asarray(speed, dtype=float) / self.peak_speed) / self.width
            load = (np.asarray(pressure, dtype=float) / self.reference_pressure) ** (
                self.pressure_exponent
            )
        bell = self.rest_share + (1.0 - self.rest_share) * np.exp(-(decades**2))
        return np.asarray(self.peak_coefficient * load * bell)

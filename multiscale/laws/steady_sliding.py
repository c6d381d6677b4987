"""Steadily sliding interface: pressure from the gap, friction from pressure and speed."""

from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.interface_law import InterfaceLaw, NormalLaw, Response
from multiscale.laws.sliding_friction import FrictionLaw

__all__ = ["SteadySliding"]

DIFFERENCE_STEP = 1e-6  # of central differences, relative to the pressure


@dataclass(frozen=True)
class SteadySliding(InterfaceLaw):
    r"""Interface law of steady sliding with one velocity of all points.

    Parameters
    ----------
    normal : NormalLaw, law of the pressure, with the initial gap
    friction : FrictionLaw
    velocity : tuple of float
        Velocity :math:`v` of side 2 relative to side 1 along each tangent, m/s, not zero.

    Raises
    ------
    CaseError
        If the velocity is zero or not finite.

    Notes
    -----
    .. math:: t_N = -p(g), \qquad t_T = \mu(p, |v|)\, p\, \frac{v}{|v|}.    \tag{1}

    The tangent is not symmetric; the derivative of :math:`\mu p` is a central difference.

    Examples
    --------
    >>> from multiscale.laws import Coulomb, Exponential
    >>> law = SteadySliding(Exponential(1e6, 1e-4), Coulomb(0.5), velocity=(2.0,))
    >>> law.respond(np.zeros((2, 1)), np.empty((0, 1))).traction.ravel()
    array([-1000000.,   500000.])
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
        """Find the jump on the law and on a search direction; see :class:`InterfaceLaw`.

        The pressure depends on the normal jump alone, and friction on the pressure alone.
        """
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

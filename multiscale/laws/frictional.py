"""Normal law with tangential stiffness and Coulomb friction."""

from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.base import InterfaceLaw, NormalLaw, Response
from multiscale.laws.sliding import limit_traction

__all__ = ["Frictional"]


@dataclass(frozen=True)
class Frictional(InterfaceLaw):
    r"""A normal law that resists sliding: elastic up to Coulomb's limit.

    Parameters
    ----------
    normal : NormalLaw
        Gives pressure p and normal stiffness K of a gap.
    friction : float
        Coefficient :math:`\mu \ge 0`.
    stiffness_ratio : float
        Tangential over normal stiffness, :math:`\kappa > 0`; :math:`2(1-\nu)/(2-\nu)` for spots
        that are far apart.

    Raises
    ------
    CaseError
        If a parameter is outside its range.

    Notes
    -----
    The state is the tangential traction and jump of the last step. From there

    .. math::
        t^*_T = t_T^- + \kappa K(g) \left([\![u_T]\!] - [\![u_T]\!]^-\right), \qquad
        t_T = \min(1, \mu p / |t^*_T|)\, t^*_T,    \tag{1}

    so that the traction never exceeds :math:`\mu p`, and slip dissipates. The normal traction is
    that of the normal law: (1) does not derive from a potential.

    References
    ----------
    .. [1] R. D. Mindlin, J. Appl. Mech. 16 (1949) 259-268.
    """

    normal: NormalLaw
    friction: float
    stiffness_ratio: float = 0.8

    n_state = 4

    def __post_init__(self) -> None:
        if not (self.friction >= 0.0 and np.isfinite(self.friction)):
            raise CaseError(f"friction must not be negative, got {self.friction:g}")
        if not (self.stiffness_ratio > 0.0 and np.isfinite(self.stiffness_ratio)):
            raise CaseError(f"stiffness_ratio must be positive, got {self.stiffness_ratio:g}")

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Evaluate (1) with its consistent tangent."""
        gap = jump[0] + self.normal.gap
        pressure, stiffness = self.normal.pressure(gap), self.normal.stiffness(gap)
        k = self.stiffness_ratio * stiffness
        step = jump[1:] - state[2:]
        trial = state[:2] + k * step
        size = np.sqrt(np.sum(trial**2, axis=0))
        limit = self.friction * pressure
        slips = size > limit
        share = np.where(slips, limit / np.where(size > 0.0, size, 1.0), 1.0)
        traction = np.stack([-pressure, *(share * trial)])

        tangent = np.zeros((3, *jump.shape))
        tangent[0, 0] = stiffness
        along = trial / np.where(size > 0.0, size, 1.0)
        slope = self.stiffness_ratio * self._stiffness_slope(gap, pressure, stiffness)
        for i in (0, 1):
            for j in (0, 1):
                across = float(i == j) - np.where(slips, along[i] * along[j], 0.0)
                tangent[1 + i, 1 + j] = share * k * across
                tangent[1 + i, 0] += share * across * slope * step[j]
            tangent[1 + i, 0] -= np.where(slips, self.friction * stiffness * along[i], 0.0)
        return Response(traction, tangent, np.concatenate([traction[1:], jump[1:]]))

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        r"""Find the jump on the law and on a search direction; see :class:`InterfaceLaw`.

        The normal row does not feel the tangents. With the pressure known, the traction is (1) of
        :func:`limit_traction` for :math:`d = t_T^- + \kappa K (b_T / k - [\![u_T]\!]^-)` and
        :math:`a = \kappa K / k`, elastic at :math:`\sigma = 1`.
        """
        stiffness = np.broadcast_to(stiffness, source.shape)
        jump = self.normal.resolvent(source, stiffness, state[:0])
        gap = jump[0] + self.normal.gap
        k = self.stiffness_ratio * self.normal.stiffness(gap)
        drive = state[:2] + k * (source[1:] / stiffness[1:] - state[2:])
        limit = self.friction * self.normal.pressure(gap)
        traction = limit_traction(drive, k / stiffness[1:], 1.0, limit)
        jump[1:] = (source[1:] - traction) / stiffness[1:]
        return jump

    def _stiffness_slope(
        self, gap: np.ndarray, pressure: np.ndarray, stiffness: np.ndarray
    ) -> np.ndarray:
        """Differentiate the normal stiffness by a central difference, Pa/m²."""
        loaded = stiffness > 0.0
        length = np.where(loaded, pressure / np.where(loaded, stiffness, 1.0), 1e-9)
        step = np.maximum(1e-5 * length, 1e-9 * np.abs(gap))
        rise = self.normal.stiffness(gap + step) - self.normal.stiffness(gap - step)
        return np.asarray(rise / (2.0 * step))

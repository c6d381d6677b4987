"""Loading and unloading of plastic contact: hysteresis of the pressure."""

from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from multiscale.laws.interface_law import (
    GapLaw,
    NormalLaw,
    Response,
    check_parameters,
    forwarded,
    newton_from_the_left,
)
from multiscale.laws.normal import PowerLaw


@dataclass(frozen=True)
class HystereticLaw(GapLaw):
    r"""Frictionless law with a stiffer unloading branch.

    Parameters
    ----------
    loading : NormalLaw, pressure :math:`p_\ell(g)` of the first loading; its initial gap is used
    stiffness_ratio : float
        Ratio :math:`\beta \ge 1` of the stiffnesses at the start of unloading and of loading,
        dimensionless.
    exponent : float, exponent :math:`n \ge 1` of the unloading branch, dimensionless
    flows : bool, false once it is shaken down: then (1) also holds above the largest pressure

    Notes
    -----
    The state is the largest pressure so far, :math:`p_m`, Pa, zero before the first loading;
    :math:`g_m` is the gap at this pressure. The interface loads while
    :math:`p_\ell(g) \ge p_m`; otherwise it unloads and reloads along

    .. math::
        p = p_m \Big\langle 1 - \frac{g - g_m}{\ell_m} \Big\rangle_+^n, \qquad
        \ell_m = \frac{n\, p_m}{\beta\, K_\ell(g_m)},    \tag{1}

    with the loading stiffness :math:`K_\ell`. The power law is taken from [1]_ for the unloading of
    an indenter; :math:`\ell_m` is the elastic recovery, and the rest of the approach is plastic.
    Loading dissipates if :math:`p_m` is at least the rate of the energy recovered by unloading,

    .. math:: p_m \ge \frac{\mathrm{d}}{\mathrm{d}(-g_m)} \frac{p_m \ell_m}{n + 1}:    \tag{2}

    for all :math:`\beta \ge 2` and, for an exponential law, for all :math:`\beta \ge 1`.

    References
    ----------
    .. [1] W. C. Oliver and G. M. Pharr, J. Mater. Res. 7 (1992) 1564-1583,
       doi:10.1557/JMR.1992.1564.

    Examples
    --------
    >>> from multiscale.laws import Exponential
    >>> law = HystereticLaw(Exponential(1.0e9, 1.0e-6), stiffness_ratio=2.0, exponent=1.5)
    >>> jump = np.array([[2.0e-6, 2.5e-6], [0.0, 0.0]])  # m
    >>> loaded = law.respond(jump, state=np.zeros((1, 2)))
    >>> loaded.traction[0]
    array([-1.35335283e+08, -8.20849986e+07])
    >>> law.respond(jump, state=np.full((1, 2), loaded.state[0, 0])).traction[0]  # after loading
    array([-1.35335283e+08, -2.60452874e+07])
    """

    loading: NormalLaw
    stiffness_ratio: float
    exponent: float
    flows: bool = True
    n_state = 1

    def __post_init__(self) -> None:
        check_parameters(self, lowest=1.0, stiffness_ratio="1", exponent="1")

    gap = forwarded("loading", "gap")
    pressure_range = forwarded("loading", "pressure_range")
    pressure_limit = forwarded("loading", "pressure_limit")
    first_loading = property(attrgetter("loading"))
    unloading_ratio = property(attrgetter("stiffness_ratio"))

    def elastic_curve(self, low: float, high: float) -> tuple[NormalLaw, float, float]:
        r"""Return :math:`\langle 1 - x\rangle_+^n` of (1), and its range between two pressures."""
        return PowerLaw(1.0, 1.0, self.exponent), low / high, 1.0

    def on_curve(
        self, gap: np.ndarray, state: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        r"""Return :math:`x = (g - g_m) / \ell_m` of (1), and its scales :math:`p_m, \ell_m`."""
        peak = state[0]
        branch = self.branch(np.where(peak > 0.0, peak, 1.0))  # without loading the force is zero
        length = np.asarray(branch.support)
        recovered = gap - self.loading.gap + branch.gap
        return (np.maximum(recovered, 0.0) if self.flows else recovered) / length, peak, length

    def shaken_down(self) -> "HystereticLaw":
        """Return the law that stays on (1), elastic where the interface has not been loaded."""
        return replace(self, flows=False)

    def branch(self, peak_pressure: np.ndarray) -> PowerLaw:
        """Return (1) from largest pressures :math:`p_m > 0`, Pa, with the gap :math:`g - g_m`."""
        peak = np.asarray(peak_pressure, dtype=float)
        corner = self.loading.gap_at(peak)
        length = self.exponent * peak / (self.stiffness_ratio * self.loading.stiffness(corner))
        gap = self.loading.gap - corner
        return PowerLaw(peak, length, self.exponent, gap)  # type: ignore[arg-type]  # point by point

    def recovery(self, pressure: np.ndarray, peak_pressure: np.ndarray) -> np.ndarray:
        """Return the recovery :math:`g - g_m`, m, of (1) at a pressure, Pa."""
        return self.branch(peak_pressure).gap_at(pressure)

    def respond(self, jump: np.ndarray, state: np.ndarray) -> Response:
        """Evaluate (1) or the loading law; the new state is the largest pressure."""
        loaded = self.loading.respond(jump, state)
        p, peak = -loaded.traction[0], state[0]
        back = p < peak if self.flows else peak > 0.0
        new = np.maximum(p, peak)[None] if self.flows else state
        if not np.any(back):
            return Response(loaded.traction, loaded.tangent, new)
        traction, tangent = loaded.traction.copy(), loaded.tangent.copy()
        unloaded = self.branch(peak[back]).respond(jump[:, back], state[:, back])
        traction[:, back] = unloaded.traction
        tangent[:, :, back] = unloaded.tangent
        return Response(traction, tangent, new)

    def resolvent(
        self, source: np.ndarray, stiffness: float | np.ndarray, state: np.ndarray
    ) -> np.ndarray:
        """Return the jump on the law and on a search direction; see :class:`InterfaceLaw`."""
        if not self.flows:
            return super().resolvent(source, stiffness, state)
        # the root lies on the loading branch if its pressure there is the largest so far
        k = np.broadcast_to(stiffness, source.shape)
        jump = self.loading.resolvent(source, k, state)
        back = self.loading.pressure(jump[0] + self.loading.gap) < state[0]
        if np.any(back):
            branch = self.branch(state[0][back])  # from the corner of both branches
            jump[:, back] = newton_from_the_left(
                branch, source[:, back], k[:, back], state[:, back], -np.asarray(branch.gap)
            )
        return jump

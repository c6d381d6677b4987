r"""Steady sliding of a viscoelastic half-space over a rough rigid body: friction by hysteresis.

In the frame of the rough body, over which the half-space moves with :math:`v` along :math:`+x`, a
mode of the wavenumbers :math:`q_x, q_y` has the frequency :math:`\omega = q_x v`,

.. math:: p_q = \frac{q\, E(\omega)}{2 (1 - \nu^2)}\, u_q. \tag{1}
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from multiscale.convergence import Status, check_limits
from multiscale.errors import CaseError, require
from multiscale.micro.averages import contact_fraction
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    from multiscale.micro.elastic.lateral_fft import SurfaceFilter

_COARSE = 1e-3  # tolerance relative to the first residual, while the active set changes


@dataclass(frozen=True)
class RelaxingSolid:
    r"""A linear viscoelastic solid with a Prony series and a constant Poisson's ratio.

    Parameters
    ----------
    relaxed_modulus : float, :math:`E_\infty > 0` after a long time, Pa
    poissons_ratio : float, :math:`0 \le \nu \le 1/2`
    moduli : tuple of float, moduli :math:`E_i > 0` that relax, Pa
    times : tuple of float
        Relaxation times :math:`\tau_i > 0` of the moduli at the reference temperature, s.

    Notes
    -----
    .. math:: E(\omega) = E_\infty + \sum_i E_i\, \frac{i\omega a_T\tau_i}{1 + i\omega a_T\tau_i}

    Examples
    --------
    >>> solid = RelaxingSolid(10e6, 0.5, (90e6,), (1.0,))
    >>> modulus = solid.complex_modulus(np.array([0.0, 1.0, 1e6]))
    >>> (modulus / 1e6).round(3)
    array([ 10. +0.j,  55.+45.j, 100. +0.j])
    """

    relaxed_modulus: float
    poissons_ratio: float
    moduli: tuple[float, ...]
    times: tuple[float, ...]

    def __post_init__(self) -> None:
        require("relaxed_modulus", self.relaxed_modulus, "(0, inf)", "Pa")
        require("poissons_ratio", self.poissons_ratio, "[0, 0.5]")
        if len(self.moduli) != len(self.times):
            raise CaseError(
                f"give one modulus for each relaxation time, got {len(self.moduli)} moduli and "
                f"{len(self.times)} times"
            )
        for name, unit in (("moduli", "Pa"), ("times", "s")):
            values = getattr(self, name)
            if not all(0.0 < value < np.inf for value in values):
                raise CaseError(f"{name} must be positive ({unit}), got {values}")

    def complex_modulus(self, frequency: np.ndarray) -> np.ndarray:
        """Complex modulus, Pa, at angular frequencies times the shift of the times, 1/s."""
        modulus = np.full(np.shape(frequency), self.relaxed_modulus, dtype=complex)
        for relaxing, time in zip(self.moduli, self.times, strict=True):
            turned = 1j * np.asarray(frequency) * time
            modulus += relaxing * turned / (1.0 + turned)
        return modulus


@dataclass(frozen=True, eq=False)
class SlidingContact:
    """Contact of a rough body and a viscoelastic half-space in steady sliding."""

    pressure: np.ndarray  # (nx, ny), Pa
    # <p dh/dx> / <p>: force on the half-space along -x, against its motion, over the load
    friction: float
    contact_fraction: float  # real over nominal contact area
    mean_gap: float  # m
    status: Status
    active_sets: int
    linear_iterations: int


def solve_sliding(
    surface: Surface,
    solid: RelaxingSolid,
    pressure: float,
    velocity: float,
    *,
    shift: float = 1.0,
    start: np.ndarray | None = None,
    max_iterations: int = 100,
    tolerance: float = 1e-8,
) -> SlidingContact:
    r"""Solve for the pressure under a rough body that slides steadily.

    Parameters
    ----------
    surface : Surface, heights of the rough body below the half-space, m; its summits touch first
    pressure : float, mean pressure, Pa, positive
    velocity : float, :math:`v`, m/s, at least 0
    shift : float, factor of all relaxation times, for instance :func:`~multiscale.laws.wlf_shift`
    start : ndarray, optional, first guess of the pressure, Pa
    tolerance : float
        Bound on the distance of contact points from contact, relative to the range of heights.

    Returns
    -------
    SlidingContact, with the status of the solver

    Notes
    -----
    With the compliance :math:`C` of (1), the approach :math:`\delta` and the gap
    :math:`g = C p + \delta - h`: :math:`0 \le p \perp g \ge 0`. The compliance is positive, though
    not symmetric: its skew part causes the friction. A primal-dual active set is solved by minimal
    residuals, preconditioned by the stiffness (1).
    """
    check_limits(tolerance, max_iterations)
    require("the pressure", pressure, "(0, inf)", "Pa")
    require("the velocity", velocity, "[0, inf)", "m/s")
    if velocity > 0.0 and not solid.moduli:
        raise CaseError(
            "the body slides but is not viscous, so the velocity has no effect; give moduli "
            "that relax, or velocity 0"
        )
    respond, stiffen, slope = _filters(surface, solid, velocity * shift)
    typical = float(np.median(np.abs(stiffen.symbol)))  # stiffness of a mode, Pa/m
    heights = surface.heights
    scale = float(np.ptp(heights))
    load = pressure * heights.size
    p = stiffen(heights - heights.mean()) + pressure if start is None else start
    active = p > 0.0
    linear, status, fine = 0, Status.MAX_ITERATIONS, False
    gap, sets = heights, 0
    while sets < max_iterations:
        sets += 1
        p = np.where(active, p, 0.0)
        p = np.where(active, p + (load - p.sum()) / active.sum(), 0.0)
        goal = tolerance * scale
        p, gap, off, iterations = _close(respond, stiffen, heights, p, active, goal, fine)
        linear += iterations
        # primal-dual active set
        following = np.where(active, p, -typical * gap) > 0.0
        changed = bool(np.any(following != active))
        if not np.isfinite(off):
            status = Status.NOT_FINITE
            break
        if not changed and fine:
            status = Status.CONVERGED if off <= goal else Status.STALLED
            break
        fine, active = not changed, following
    return SlidingContact(
        p,
        float(np.sum(p * slope) / load),
        contact_fraction(p, np.ones_like(p)),
        float(gap.mean()),
        status,
        sets,
        linear,
    )


def _filters(
    surface: Surface, solid: RelaxingSolid, velocity: float
) -> "tuple[SurfaceFilter, SurfaceFilter, np.ndarray]":
    """Return filters from pressure to displacement and back (1), and slopes along x."""
    from multiscale.micro.elastic.lateral_fft import SurfaceFilter

    (nx, ny), (lx, ly) = surface.heights.shape, surface.size
    across = 2.0 * np.pi / ly * np.arange(ny // 2 + 1)
    along = 2.0 * np.pi / lx * np.fft.fftfreq(nx, 1.0 / nx)[:, None] + 0.0 * across
    undirected = slice(nx // 2, nx // 2 + 1 - nx % 2)
    modulus, slope = solid.complex_modulus(along * velocity), 1j * along
    modulus[undirected], slope[undirected] = modulus[undirected].real, 0.0
    symbol = np.hypot(along, across) * modulus / (2.0 * (1.0 - solid.poissons_ratio**2))
    compliance = np.divide(1.0, symbol, out=np.zeros_like(symbol), where=symbol != 0.0)
    heights = surface.heights
    return SurfaceFilter(compliance), SurfaceFilter(symbol), SurfaceFilter(slope)(heights)


def _close(
    respond: "SurfaceFilter",
    stiffen: "SurfaceFilter",
    heights: np.ndarray,
    p: np.ndarray,
    active: np.ndarray,
    goal: float,
    fine: bool,
) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Bring active points into contact at a constant load: pressure, gap, distance, iterations."""
    from multiscale.numerics.krylov import minimal_residual

    def centred(values: np.ndarray) -> np.ndarray:
        return np.where(active, values - values[active].mean(), 0.0)

    def apply(x: np.ndarray) -> np.ndarray:
        return centred(respond(x.reshape(active.shape))).ravel()

    def precondition(r: np.ndarray) -> np.ndarray:
        return centred(stiffen(r.reshape(active.shape))).ravel()

    off = centred(heights - respond(p)).ravel()
    aim = 0.3 * goal if fine else max(0.3 * goal, _COARSE * float(np.linalg.norm(off)))
    change, iterations = minimal_residual(apply, off, precondition, goal=aim, room=200)
    p = p + change.reshape(active.shape)
    gap = respond(p) - heights
    gap = gap - gap[active].mean()
    return p, gap, float(np.abs(gap[active]).max()), iterations

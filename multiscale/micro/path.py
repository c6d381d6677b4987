"""Paths of cells: pressed, slid or sheared step by step."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import branch_of
from multiscale.surfaces.statistics import rms_height

if TYPE_CHECKING:
    from multiscale.micro.cell import FiniteCell

__all__ = ["Path", "Target", "shear_path"]

REACH = 8.0
"""Largest slip of the interface, relative to that over which a joint gives way: full slip."""

DECAY = 0.4  # p / K over the rms height of a self-affine surface at light load


@dataclass(frozen=True, eq=False)
class Target:
    """End of a step of a path, or of an increment of it.

    Attributes
    ----------
    load : float or None, vertical load, N; None if the approach is prescribed
    approach : float or None, approach of the obstacle, m; None if the load is prescribed
    slide : ndarray, shape (2,), displacement of the obstacle in its plane, m
    time_step : float, duration, s
    """

    load: float | None
    approach: float | None
    slide: np.ndarray
    time_step: float = 0.0


@dataclass(frozen=True, eq=False)
class Path:
    """A sequence of load steps, each started from the one before.

    Parameters
    ----------
    pressure : tuple of float, optional
        Mean pressure at each step, Pa, at least 0.
    approach : tuple of float, optional
        Approach of the obstacle counted from the first touch, m. Give one of the two.
    slide : tuple of pairs of float, optional
        Displacement of the obstacle in its plane at each step, m.
    time : tuple of float, optional
        Time at the end of each step, s, rising from 0: for a viscous body.
    increments : int
        Fewest increments of a step. More are taken where a body flows, slides or does not
        converge.
    refinement : int, how many times shorter than by default the increments of a body that flows are

    Raises
    ------
    CaseError
        If both or neither of pressure and approach are given, or a value is refused.
    """

    pressure: tuple[float, ...] | None = None
    approach: tuple[float, ...] | None = None
    slide: tuple[tuple[float, float], ...] | None = None
    time: tuple[float, ...] | None = None
    increments: int = 1
    refinement: int = 1

    def __post_init__(self) -> None:
        if (self.pressure is None) == (self.approach is None):
            raise CaseError("a path prescribes either pressures or approaches; give one of them")
        name = "approach" if self.pressure is None else "pressure"
        steps = tuple(float(value) for value in getattr(self, name))
        if not steps or not np.all(np.isfinite(steps)):
            raise CaseError(f"a path needs at least one step and finite values, got {steps}")
        if self.pressure is not None and min(steps) < 0.0:
            raise CaseError(
                f"pressures must not be negative (Pa), got {min(steps):g}; adhesion is not modelled"
            )
        object.__setattr__(self, name, steps)
        for name in ("increments", "refinement"):
            if getattr(self, name) < 1:
                raise CaseError(f"{name} of a path must be at least 1, got {getattr(self, name)}")
        if self.slide is not None:
            slide = np.asarray(self.slide, dtype=float)
            if slide.shape != (len(steps), 2) or not np.all(np.isfinite(slide)):
                raise CaseError(
                    f"slide needs two finite lengths (m) for each of the {len(steps)} steps, got "
                    f"shape {slide.shape}"
                )
        if self.time is not None:
            times = np.array([0.0, *self.time], dtype=float)
            if len(times) != len(steps) + 1 or not np.all(np.diff(times) >= 0.0):
                raise CaseError(
                    f"time needs one value for each of the {len(steps)} steps, rising from 0 (s), "
                    f"got {self.time}"
                )

    @property
    def branch(self) -> np.ndarray:
        """Branch of each step: loading, unloading or holding; see `multiscale.schema.branch_of`."""
        return branch_of(np.array(self.pressure or self.approach))

    def __len__(self) -> int:
        return len(self.pressure or self.approach or ())

    def target(self, k: int, area: float) -> Target:
        """End of step k on a cell with a nominal area, m2."""
        before = self.time[k - 1] if self.time is not None and k > 0 else 0.0
        return Target(
            None if self.pressure is None else self.pressure[k] * area,
            None if self.approach is None else self.approach[k],
            np.zeros(2) if self.slide is None else np.array(self.slide[k], dtype=float),
            0.0 if self.time is None else self.time[k] - before,
        )


def shear_path(
    cell: "FiniteCell",
    pressures: Sequence[float],
    *,
    along: Literal["x", "y", "xy"] = "xy",
    steps: int = 10,
    cycle: float = 0.0,
    pressed: Sequence[float] = (),
) -> Path:
    r"""Press, shear and release a cell at each of several pressures and in each direction.

    Parameters
    ----------
    cell : FiniteCell
        With friction; two deformable bodies, as a rigid obstacle couples pressing and shear. Tells
        the lengths of the path, which serves all realisations.
    pressures : sequence of float, mean pressures that are held, Pa
    along : {"x", "y", "xy"}, directions of the shear
    steps : int, number of steps to full slip; the first ones are short
    cycle : float
        Amplitude of a closed cycle on the way, relative to the slip :math:`u_*` below, at the step
        that is nearest: it tells what the cell loses. None if zero.
    pressed : sequence of float
        Mean pressures through which the cell is pressed and then released at first, Pa, rising: it
        then tells its own normal law, on the grid on which it is sheared.

    Returns
    -------
    Path
        Sheared to :data:`REACH`, the cell is released: pressure and slide zero. An elastic cell
        then forgets its path.

    Raises
    ------
    CaseError
        If the cell has no friction, or a number makes no sense.

    Notes
    -----
    The bodies move by the slip :math:`u` of the interface and by their own shear. For an interface
    whose pressure is :math:`e`-fold over the length :math:`\lambda \approx 0.4\, h_\mathrm{rms}`,

    .. math::
        s(u) = u + f(u) \sum_k D_k / G_k, \qquad f = \mu p\, (1 - e^{-u / u_*}), \qquad
        u_* = \mu \lambda / \kappa,    \tag{1}

    with the depths :math:`D` and shear moduli :math:`G` of the bodies and
    :math:`\kappa = 2(1-\nu)/(2-\nu)`; Masing's rule gives the way back. What the cell makes of it
    is measured, so that (1) need not be exact.
    """
    mu = cell.friction_coefficient
    if not mu > 0.0:
        raise CaseError("a cell without friction cannot be sheared; give a friction_coefficient")
    if not pressures or not all(0.0 < one < np.inf for one in pressures):
        raise CaseError(f"a cell is sheared under positive pressures (Pa), got {pressures}")
    if not all(0.0 < one < np.inf for one in pressed):
        raise CaseError(f"a cell is pressed by positive pressures (Pa), got {pressed}")
    if along not in ("x", "y", "xy"):
        raise CaseError(f"a cell is sheared along 'x', 'y' or 'xy', got {along!r}")
    if steps < 1:
        raise CaseError(f"a shear needs at least 1 step, got {steps}")
    if not 0.0 <= cycle < REACH:
        raise CaseError(
            f"a cycle lies on the way to full slip, with an amplitude from 0 to less than "
            f"{REACH:g}, got {cycle:g}"
        )
    heights = [rms_height(body.surface) for body in cell.bodies]
    heights += [] if cell.second or cell.obstacle is None else [rms_height(cell.obstacle)]
    nu = float(np.mean(cell.law.poissons_ratio))
    kappa = 2.0 * (1.0 - nu) / (2.0 - nu)
    scale = mu * DECAY * float(np.linalg.norm(heights)) / kappa
    if not scale > 0.0:
        raise CaseError("the surfaces are flat, so that nothing slips before all of it does")
    compliance = sum(np.sum(np.diff(body.planes) / body.layer_moduli[1]) for body in cell.bodies)
    rise = (np.arange(1, steps + 1) / steps) ** 2  # share of the way

    turn = int(np.argmin(np.abs(REACH * rise - cycle)))  # the step at which a cycle begins

    pressure: list[float] = [*pressed, 0.0] if pressed else []
    slide: list[tuple[float, float]] = [(0.0, 0.0)] * len(pressure)
    for p in pressures:
        force, slip = mu * p * -np.expm1(-REACH * rise), REACH * scale * rise  # (1)
        way = slip + force * compliance
        if cycle:  # Masing: twice the way at twice the slip
            middle = 2.0 * mu * p * -np.expm1(-0.5 * slip[turn] / scale) * compliance
            middle = way[turn] - slip[turn] - middle  # where the slip is zero on the way back
            there = [middle, -way[turn], -middle, way[turn]]
            way = np.concatenate([way[: turn + 1], there, way[turn + 1 :]])
        way = np.concatenate([[0.0], way, [0.0]])
        for axis in along:
            pressure += [p] * (len(way) - 1) + [0.0]
            slide += [(float(s), 0.0) if axis == "x" else (0.0, float(s)) for s in way]
    return Path(pressure=tuple(pressure), slide=tuple(slide))

"""Shear of cells to full slip, and sliding of their counterface."""

from collections.abc import Sequence
from concurrent.futures import Executor
from typing import Literal

import numpy as np

from multiscale.convergence import check_limits
from multiscale.errors import CaseError, require
from multiscale.executors import run_jobs
from multiscale.laws.bulk.bulk_law import mindlin_ratio
from multiscale.micro.cell import GridCell, solve_cell
from multiscale.micro.finite.finite_cell import FiniteCell
from multiscale.micro.path import Path
from multiscale.schema import SLIDING_RESPONSE, Dataset
from multiscale.surfaces.fourier import rms_height

REACH = 8.0  # largest slip of the interface, relative to the slip u_* of (1): full slip
DECAY = 0.4  # pressure over stiffness and rms height, of a self-affine surface at light load
LONGEST_SLIDE = 20.0  # longest slide in periods of the cell


def shear_path(
    cell: FiniteCell,
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
        Cell with friction and two deformable bodies, as a rigid obstacle couples pressing and
        shear. The lengths of the path follow from it and apply to all realisations.
    pressures : sequence of float, mean pressures under which the cell is sheared, Pa
    along : {"x", "y", "xy"}, directions of the shear
    steps : int, number of steps to full slip, short at the beginning
    cycle : float
        Amplitude of a closed cycle on the way, relative to the slip :math:`u_*` below, at the
        nearest step, for the energy that the cell dissipates. Zero: no cycle.
    pressed : sequence of float
        Mean pressures, Pa, rising, of a loading and release before the shear, which measures the
        normal law on the same grid.

    Returns
    -------
    Path
        Sheared to :data:`REACH`, the cell is released: pressure and slide zero. An elastic cell
        then has no history.

    Notes
    -----
    The bodies move by the slip :math:`u` of the interface and by their shear. For an interface with
    a pressure that grows by the factor e over the length
    :math:`\lambda \approx 0.4\, h_\mathrm{rms}`,

    .. math::
        s(u) = u + f(u) \sum_k D_k / G_k, \qquad f = \mu p\, (1 - e^{-u / u_*}), \qquad
        u_* = \mu \lambda / \kappa,    \tag{1}

    with the depths :math:`D` and shear moduli :math:`G` of the bodies and
    :math:`\kappa = 2(1-\nu)/(2-\nu)`; Masing's rule gives the way back. The response of the cell
    is measured, so that (1) need not be exact.
    """
    mu = cell.friction_coefficient
    if not mu > 0.0:
        raise CaseError("a cell without friction cannot be sheared; give a friction_coefficient")
    if not pressures or not all(0.0 < p < np.inf for p in pressures):
        raise CaseError(f"a cell is sheared under positive pressures (Pa), got {pressures}")
    if not all(0.0 < p < np.inf for p in pressed):
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
    # slip u_* and compliance of the bodies
    heights = [rms_height(body.surface) for body in cell.bodies]
    heights += [] if cell.second or cell.obstacle is None else [rms_height(cell.obstacle)]
    nu = float(np.mean(cell.law.poissons_ratio))
    scale = mu * DECAY * float(np.linalg.norm(heights)) / mindlin_ratio(nu)
    if not scale > 0.0:
        raise CaseError("the surfaces are flat, so there is no partial slip")
    compliance = sum(np.sum(np.diff(body.planes) / body.layer_moduli[1]) for body in cell.bodies)
    rise = (np.arange(1, steps + 1) / steps) ** 2  # share of the way
    turn = int(np.argmin(np.abs(REACH * rise - cycle)))  # the step at which a cycle begins

    # press and release, then shear along each direction at each pressure
    pressure: list[float] = [*pressed, 0.0] if pressed else []
    slide: list[tuple[float, float]] = [(0.0, 0.0)] * len(pressure)
    for p in pressures:
        force, slip = mu * p * -np.expm1(-REACH * rise), REACH * scale * rise  # (1)
        way = slip + force * compliance
        if cycle:  # Masing: twice the way at twice the slip
            middle = 2.0 * mu * p * -np.expm1(-0.5 * slip[turn] / scale) * compliance
            middle = way[turn] - slip[turn] - middle  # where the slip is zero on the way back
            loop = [middle, -way[turn], -middle, way[turn]]
            way = np.concatenate([way[: turn + 1], loop, way[turn + 1 :]])
        way = np.concatenate([[0.0], way, [0.0]])
        for axis in along:
            pressure += [p] * (len(way) - 1) + [0.0]
            slide += [(float(s), 0.0) if axis == "x" else (0.0, float(s)) for s in way]
    return Path(pressure=tuple(pressure), slide=tuple(slide))


def slide_cell(
    cell: GridCell,
    pressure: tuple[float, ...],
    distance: float,
    *,
    steps: int = 16,
    executor: Executor | None = None,
    tolerance: float = 1e-8,
) -> Dataset:
    r"""Press a cell, then slide its counterface over it along x, at each of several pressures.

    Parameters
    ----------
    cell : GraphCell or FiniteCell, with a rigid obstacle or two bodies
    pressure : tuple of float, mean pressures, Pa, positive; each starts from the undeformed cell
    distance : float
        Sliding distance, m. An elastic cell repeats itself after a period of its surface; a
        plastic cell is run in after a few periods.
    executor : Executor, optional, runs the pressures; see :func:`multiscale.executors.run_jobs`
    tolerance : float, see :func:`multiscale.micro.solve_cell`

    Returns
    -------
    Dataset
        Follows ``SLIDING_RESPONSE``. After a failed step the values of a pressure are ``NaN``.

    Notes
    -----
    With the averages (2) and (3) of the source and the unit vector :math:`e` of x,

    .. math:: \mu = \frac{\langle t_T \rangle \cdot e}{-\langle t_N \rangle},    \tag{1}

    and the steady value is its mean over the steps of the last period.
    """
    check_limits(tolerance)
    if not pressure or not all(0.0 < p < np.inf for p in pressure):
        raise CaseError(f"a cell slides under positive pressures (Pa), got {pressure}")
    if steps < 1:
        raise CaseError(f"sliding takes at least 1 step, got {steps}")
    require("the sliding distance", distance, "(0, inf)", "m")
    period = cell.surface.size[0]
    if distance > LONGEST_SLIDE * period:
        raise CaseError(
            f"a slide of {distance:.3g} m is {distance / period:.3g} periods of the cell; an "
            f"elastic cell repeats itself after a period, and a plastic cell is run in after a "
            f"few: slide at most {LONGEST_SLIDE:g} periods"
        )
    slide = np.zeros((steps + 1, 2))
    slide[:, 0] = np.linspace(0.0, distance, steps + 1)
    runs: dict[int, Dataset] = {}
    jobs = ((k, (cell, p, slide, tolerance)) for k, p in enumerate(pressure))
    run_jobs(_slide_once, jobs, executor, runs.__setitem__)

    values = {
        name: np.concatenate([runs[k][name].values for k in range(len(pressure))])
        for name in (*SLIDING_RESPONSE.variables, *SLIDING_RESPONSE.optional)
        if name in runs[0]
    }
    traction = values["traction"]
    values["effective_friction"] = -traction[..., 1] / traction[..., 0]  # (1)
    late = slide[:, 0] > distance - period * (1.0 - 1e-9)  # the steps of the last period
    steady = values["effective_friction"][:, late].mean(axis=1)
    full_period = distance - period >= -1e-9 * period
    values["steady_friction"] = steady if full_period else np.full(len(pressure), np.nan)
    values |= {"nominal_pressure": np.array(pressure), "sliding_distance": slide[:, 0]}
    ended = "; ".join(
        f"{p:.3g} Pa: {runs[k].attrs['ended']}"
        for k, p in enumerate(pressure)
        if "ended" in runs[k].attrs
    )
    return SLIDING_RESPONSE.build(values, along="x", **({"ended": ended} if ended else {}))


def _slide_once(cell: GridCell, pressure: float, slide: np.ndarray, tolerance: float) -> Dataset:
    path = Path(
        pressure=(pressure,) * len(slide), slide=tuple((float(x), float(y)) for x, y in slide)
    )
    return solve_cell(cell, path, tolerance=tolerance)

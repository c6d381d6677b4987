"""Friction of a whole cell against pressure and sliding distance."""

from concurrent.futures import Executor

import numpy as np

from multiscale.convergence import check_limits
from multiscale.errors import CaseError
from multiscale.executors import run_jobs
from multiscale.micro.cell import GridCell
from multiscale.micro.cell_solver import solve_cell
from multiscale.micro.path import Path
from multiscale.schema import SLIDING_RESPONSE, Dataset

__all__ = ["slide_cell"]

LONGEST = 20.0  # periods of a cell
_KEPT = (
    "traction",
    "mean_gap",
    "contact_fraction",
    "slip_fraction",
    "friction_work",
    "flowing_fraction",
    "converged",
    "active_set_iterations",
    "linear_iterations",
    "increments",
    "wall_time",
)


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
        How far to slide, m. After one period of the cell an elastic cell repeats itself; a plastic
        one is run in after some.
    steps : int
    executor : Executor, optional
        For the pressures; see :func:`multiscale.executors.run_jobs`.
    tolerance : float, as of :func:`multiscale.micro.solve_cell`

    Returns
    -------
    Dataset
        Follows ``SLIDING_RESPONSE``. A pressure at which the path could not go on is ``NaN`` from
        there.

    Raises
    ------
    CaseError
        If a pressure or the distance makes no sense.

    Notes
    -----
    With the averages (2) and (3) of the source and the unit vector :math:`e` of x,

    .. math:: \mu = \frac{\langle t_T \rangle \cdot e}{-\langle t_N \rangle},    \tag{1}

    and the steady value is its mean over the steps of the last period.
    """
    check_limits(tolerance)
    if not pressure or not all(0.0 < one < np.inf for one in pressure):
        raise CaseError(f"a cell slides under positive pressures (Pa), got {pressure}")
    if steps < 1:
        raise CaseError(f"sliding takes at least 1 step, got {steps}")
    if not 0.0 < distance < np.inf:
        raise CaseError(f"the sliding distance must be positive (m), got {distance:g}")
    period = cell.surface.size[0]
    if distance > LONGEST * period:
        raise CaseError(
            f"a slide of {distance:.3g} m is {distance / period:.3g} periods of the cell; it "
            f"repeats itself after one, and is run in after a few where it flows: slide at most "
            f"{LONGEST:g}"
        )
    slide = np.zeros((steps + 1, 2))
    slide[:, 0] = np.linspace(0.0, distance, steps + 1)
    found: dict[int, Dataset] = {}
    jobs = ((k, (cell, one, slide, tolerance)) for k, one in enumerate(pressure))
    run_jobs(_slide_once, jobs, executor, found.__setitem__)

    values = {
        name: np.concatenate([found[k][name].values for k in range(len(pressure))])
        for name in _KEPT
        if name in found[0]
    }
    traction = values["traction"]
    values["effective_friction"] = -traction[..., 1] / traction[..., 0]  # (1)
    late = slide[:, 0] > distance - period * (1.0 - 1e-9)  # the steps of the last period
    steady = values["effective_friction"][:, late].mean(axis=1)
    whole = distance - period >= -1e-9 * period
    values["steady_friction"] = steady if whole else np.full(len(pressure), np.nan)
    values |= {"nominal_pressure": np.array(pressure), "sliding_distance": slide[:, 0]}
    ended = "; ".join(
        f"{one:.3g} Pa: {found[k].attrs['ended']}"
        for k, one in enumerate(pressure)
        if "ended" in found[k].attrs
    )
    return SLIDING_RESPONSE.build(values, along="x", **({"ended": ended} if ended else {}))


def _slide_once(cell: GridCell, pressure: float, slide: np.ndarray, tolerance: float) -> Dataset:
    path = Path(
        pressure=(pressure,) * len(slide), slide=tuple((float(x), float(y)) for x, y in slide)
    )
    return solve_cell(cell, path, tolerance=tolerance)

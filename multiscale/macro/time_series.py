"""Datasets of dynamic results."""

from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.macro.discrete.description import describe
from multiscale.macro.discrete.link_system import LinkSystem
from multiscale.schema import MACRO_RESULT

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["failed_step", "join_times"]


def failed_step(
    first: dict[str, Any], time: float, residual: float, seconds: float
) -> dict[str, Any]:
    """Return the variables of a failed step, NaN in the shapes of the first row.

    Parameters
    ----------
    first : dict, variables of the first row
    time : float, time at the end of the step, s
    residual : float, residual reached, dimensionless
    seconds : float, wall time of the step, s
    """
    row = {name: np.full_like(value, np.nan, dtype=float) for name, value in first.items()}
    return row | {"time": time, "converged": 0, "residual": residual, "wall_time": seconds}


def join_times(system: LinkSystem, rows: list[dict[str, Any]]) -> "xr.Dataset":
    """Return the steps as a dataset that follows ``MACRO_RESULT``, with work and losses summed.

    Parameters
    ----------
    rows : list of dict, variables of each step
    """
    import xarray as xr

    values = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    for name in ("work", "numerical_dissipation", "link_dissipation"):
        values[name] = np.cumsum(values[name])
    result = MACRO_RESULT.assign(xr.Dataset(), values | describe(system))
    result = result.assign_coords(
        step=range(len(rows)),
        link=range(system.n_links),
        node=range(system.n_nodes),
        component=["x", "y", "z"],
    )
    MACRO_RESULT.check(result)
    return result

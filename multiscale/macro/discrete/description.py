"""Datasets of structures of links."""

from typing import Any

import numpy as np

from multiscale.macro.discrete.compatibility import LinkEquations
from multiscale.macro.discrete.link_state import LinkState
from multiscale.macro.discrete.link_system import LinkSystem
from multiscale.schema import MACRO_RESULT, Dataset

__all__ = ["describe", "join_steps", "link_dataset", "step_values"]


def describe(system: LinkSystem) -> dict[str, Any]:
    """Return position, ends and law of ``MACRO_RESULT``, from which the structure is drawn."""
    names = np.array([type(law).__name__.lower() for law in system.laws])
    return {"position": system.position, "ends": system.ends, "law": names[system.kind]}


def link_dataset(system: LinkSystem, values: dict[str, Any], **labels: Any) -> Dataset:
    """Return variables of steps as a dataset that follows ``MACRO_RESULT``, with the structure."""
    import xarray as xr

    labels |= {"link": range(system.n_links), "node": range(system.n_nodes)}
    result = MACRO_RESULT.assign(xr.Dataset(), values | describe(system))
    result = result.assign_coords(component=["x", "y", "z"], **labels)
    MACRO_RESULT.check(result)
    return result


def step_values(system: LinkSystem, model: LinkEquations, state: LinkState) -> dict[str, Any]:
    """Return the variables of a step, NaN unless it converged."""
    solution, links = state.solution, system.n_links
    valid = 1.0 if solution.converged else np.nan
    motion = valid * model.at_nodes(solution.value)
    column: dict[str, Any] = {
        "converged": int(solution.converged),
        "residual": solution.residuals[-1] if solution.residuals else np.nan,
        "iterations": len(solution.residuals),
        "tension": valid * state.tension[:links],
        "slack": valid * state.slack[:links],
        "displacement": motion[:, :3],
    }
    if system.n_components == 6:
        column["rotation"] = motion[:, 3:]
        twist, even_y, odd_y, even_z, odd_z = state.tension[links:].reshape(-1, 5).T
        moment = np.full((links, 5), np.nan)
        moment[model.link[links::5]] = np.stack(
            [twist, odd_y + even_y, odd_y - even_y, odd_z + even_z, odd_z - even_z], axis=1
        )
        column["moment"] = valid * moment
    return column


def join_steps(system: LinkSystem, factors: np.ndarray, columns: list[dict[str, Any]]) -> Dataset:
    """Join the variables of each step, from :func:`step_values`, at its load factor."""
    names = [name for column in columns for name in column]
    values = {
        name: np.array([column.get(name, np.nan) for column in columns])
        for name in dict.fromkeys(names)
    }
    part = {"part": ["torsion", "y1", "y2", "z1", "z2"]} if system.n_components == 6 else {}
    values |= {"load_factor": factors}
    return link_dataset(system, values, step=range(factors.size), end=range(2), **part)

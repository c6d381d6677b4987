"""Zones of a structure that a Newton step leaves far from equilibrium."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.sparse.csgraph import connected_components

from multiscale.macro.discrete.compatibility import LinkEquations
from multiscale.macro.discrete.link_tangent import Tangent, place_rows
from multiscale.numerics.compiled import compiled

__all__ = ["unbalanced_zones"]

CORE_SHARE = 0.01
"""Force out of balance from which an unknown is in the core of a zone, relative to the largest."""

MIN_RINGS, MAX_RINGS = 2, 20
"""Rings of links around the cores: fewer leave the change no room, more gain nothing."""

ZONE_SHARE = 0.1
"""Share of the unknowns up to which zones cost less than they save."""


def unbalanced_zones(
    model: LinkEquations, tangent: Tangent, load: np.ndarray, elastic: np.ndarray
) -> Iterator[tuple[np.ndarray, LinkEquations, Tangent, float]]:
    """Yield the parts of a structure around its largest forces out of balance."""
    force = model.prestress + elastic
    residual = np.abs(load - model.gather(np.clip(force, model.lower, model.upper)))
    zone, rings = residual > CORE_SHARE * residual.max(), 0
    while rings < MAX_RINGS:
        larger = _with_neighbours(model.unknown, zone)
        if np.count_nonzero(larger) > ZONE_SHARE * model.n:
            break
        zone, rings = larger, rings + 1
    if rings < MIN_RINGS:
        return

    unknowns = np.flatnonzero(zone)
    graph = tangent.pattern[unknowns][:, unknowns]
    count, part = connected_components(graph, directed=False)
    part_of, position = np.full(model.n + 1, -1), np.full(model.n + 1, -1, dtype=np.int32)
    part_of[unknowns] = part
    row_part = part_of[model.unknown].max(axis=1)  # -1, a fixed component, selects the last entry
    for rows, inside in zip(_members(row_part, count), _members(part, count), strict=True):
        position[unknowns[inside]] = np.arange(inside.size)
        equations = replace(
            model,
            link=model.link[rows],
            unknown=position[model.unknown[rows]],
            coefficient=model.coefficient[rows],
            stiffness=model.stiffness[rows],
            prestress=force[rows],
            lower=model.lower[rows],
            upper=model.upper[rows],
            load=load[unknowns[inside]],
            number=model.number[:0],
        )
        upper = graph[inside][:, inside]
        upper.sort_indices()
        part_tangent = place_rows(equations, upper.indptr, upper.indices)
        yield unknowns[inside], equations, part_tangent, float(residual.max())


def _members(part: np.ndarray, count: int) -> list[np.ndarray]:
    """Return the entries of each part, rising, of an array of their part, or of -1."""
    order = np.argsort(part, kind="stable")
    return np.split(order, np.searchsorted(part[order], np.arange(count + 1)))[1:-1]


@compiled
def _with_neighbours(unknown: np.ndarray, zone: np.ndarray) -> np.ndarray:
    """Return a set of unknowns, shape (n,), with all that a row of B connects to it."""
    larger = zone.copy()
    for row in range(unknown.shape[0]):
        touched = False
        for p in range(unknown.shape[1]):
            if unknown[row, p] >= 0 and zone[unknown[row, p]]:
                touched = True
        if touched:
            for p in range(unknown.shape[1]):
                if unknown[row, p] >= 0:
                    larger[unknown[row, p]] = True
    return larger

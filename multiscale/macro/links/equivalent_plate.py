"""Structures of links as plates: cells in place of the links, at rest and for frequencies."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from time import perf_counter
from typing import Any

import numpy as np
from numpy.linalg import norm
from scipy.sparse import csr_array, vstack

from multiscale.convergence import Solution
from multiscale.errors import CaseError, MultiscaleError, require
from multiscale.macro.continuum.plate import (
    UNKNOWNS,
    PlateElements,
    plate_elements,
    smooth_at,
)
from multiscale.macro.links.link_system import LinkSystem, link_dataset
from multiscale.macro.links.plate_cells import STRAINS, PlateCell, PlateResponse
from multiscale.macro.links.vibration import lowest_frequencies
from multiscale.numerics.factorisation import factorise
from multiscale.numerics.newton import Limits, NewtonRun, step_length
from multiscale.schema import MACRO_RESULT, Dataset

ON_EDGE = 1e-9  # distance from an edge, over the size of a structure, of nodes on it

OF_PLATE = "the stiffness of the plate"


@dataclass(frozen=True, eq=False)
class EquivalentPlate:
    """A rectangular structure of links that repeats a cell, as a plate.

    The plate carries the loads and masses of the structure at its nodes, which move with the
    sections of the plate. An edge at which all nodes at z = 0 are fixed along an axis is fixed so,
    free to turn.

    Parameters
    ----------
    system : LinkSystem
        The structure, from a corner at the origin; its fixed nodes are all nodes at z = 0 of some
        edges.
    elements : tuple of int, elements of the plate along x and y

    Raises
    ------
    CaseError
        If other nodes are fixed, or none, or no edge has nodes between its corners.
    """

    system: LinkSystem
    cell: PlateCell
    elements: tuple[int, int]

    def __post_init__(self) -> None:
        fixed = np.asarray(self.system.fixed)[:, :3]
        by_edge = np.any(self._edges[..., None] & self._supports[:, None], axis=0)
        if not np.any(self._edges.sum(axis=1) > 2):
            raise CaseError(
                "an equivalent plate has only corners at z = 0, each on two edges; give it "
                "more modules"
            )
        odd = np.flatnonzero(np.any(fixed & ~by_edge, axis=1))
        if odd.size or not fixed.any():
            where = f"node {odd[0]} is fixed apart" if odd.size else "no node is fixed"
            raise CaseError(
                f"an equivalent plate must be fixed along whole edges at z = 0, and {where}; fix "
                f"all nodes at z = 0 of an edge, and no others"
            )

    @property
    def size(self) -> tuple[float, float]:
        """Lengths along x and y, m."""
        x, y = self.system.position[:, :2].max(axis=0)
        return float(x), float(y)

    @property
    def _edges(self) -> np.ndarray:
        """Whether nodes at z = 0 lie on each of the four edges, shape (4, nodes)."""
        x, y, z = self.system.position.T
        low = np.abs(z) <= ON_EDGE * max(self.size)
        return np.asarray(_on_edges(np.stack([x, y]), self.size) & low)

    @property
    def _supports(self) -> np.ndarray:
        """Whether these nodes of each edge are some, all fixed along each axis, shape (4, 3)."""
        fixed, edges = np.asarray(self.system.fixed)[:, :3], self._edges
        whole = np.array([edge.any() & fixed[edge].all(axis=0) for edge in edges])
        # corners lie on two edges: they fix an edge without further nodes if no other edge has them
        longer = edges.sum(axis=1) > 2
        covered = np.any(edges[longer, :, None] & whole[longer, None], axis=0)
        apart = np.array([np.any(~covered[edge], axis=0) for edge in edges])
        return np.asarray(whole & (longer[:, None] | apart))

    @cached_property
    def plate(self) -> PlateElements:
        """Elements, with the nodes of the structure as places."""
        return plate_elements(self.size, self.elements, self.system.position[:, :2].T)

    @cached_property
    def members(self) -> np.ndarray:
        """Links of every cell in the order of the cell, shape (cells, links)."""
        system, links = self.system, len(self.cell.elastic)
        stretch = system.length[:, None] * system.direction[:, [0, 1, 0]]
        stretch *= system.direction[:, [0, 1, 1]]  # by extensions and shear in the plane
        order = np.argsort(system.group, kind="stable")
        whole = order.size % links == 0
        if whole and np.allclose(stretch[order].reshape(-1, links, 3), self.cell.strain[:, :3]):
            return np.asarray(order.reshape(-1, links))
        raise CaseError(
            "each group of links of an equivalent plate must be equal to its cell, with the same "
            "links in the same order; give every cell a group"
        )

    @cached_property
    def middle(self) -> np.ndarray:
        """Middles of the cells, shape (2, cells), m."""
        ends = self.system.position[self.system.ends[self.members], :2]
        return np.asarray(ends.mean(axis=(1, 2)).T)

    @cached_property
    def ring(self) -> np.ndarray:
        """Number of cells between each cell and the edge, shape (cells,)."""
        plan = np.round(self.middle / max(self.size) / ON_EDGE)
        rank = np.array([np.unique(x, return_inverse=True)[1] for x in plan])
        return np.asarray(np.minimum(rank, rank.max(axis=1, keepdims=True) - rank).min(axis=0))

    @cached_property
    def smooth(self) -> csr_array:
        """Operator from values at the points of the plate to its cells."""
        return smooth_at(self.size, self.elements, self.middle)

    def elastic_tension(self, u: np.ndarray) -> np.ndarray:
        """Return the tension without slack of all links, (links,), N, in their cells."""
        strain = self.smooth @ self.plate.strain(u)
        elastic = np.zeros(self.system.n_links)
        elastic[self.members] = self.cell.elastic_tension(strain, self.cell.respond(strain).relaxed)
        return elastic

    @cached_property
    def free(self) -> np.ndarray:
        """Numbers of the unknowns of the plate that are not fixed."""
        fixed = np.zeros((self.plate.position.shape[1], UNKNOWNS), dtype=bool)
        edges = _on_edges(self.plate.position, self.size)
        for axes, here in zip(self._supports, edges, strict=True):
            fixed[here, :3] |= axes
        return np.flatnonzero(~fixed.ravel())

    @cached_property
    def motion(self) -> list[csr_array]:
        """Operators to the displacements of the nodes of the structure along x, y and z."""
        return self.plate.section_motion(self.system.position[:, 2])

    @cached_property
    def load(self) -> np.ndarray:
        """Force on the unknowns at load factor 1, N and N m."""
        pairs = zip(self.motion, self.system.load.T, strict=True)
        return np.asarray(sum(along.T @ load for along, load in pairs))

    def stiffness(self, tangent: np.ndarray) -> csr_array:
        """Assemble tangents at all points for the free unknowns."""
        return csr_array(self.plate.assemble(tangent)[self.free][:, self.free])


def _on_edges(plan: np.ndarray, size: tuple[float, float]) -> np.ndarray:
    """Whether positions of shape (2, points) lie on each edge of a rectangle, shape (4, points)."""
    near = ON_EDGE * max(size)
    return np.array([np.abs(plan[k] - end) <= near for k in range(2) for end in (0.0, size[k])])


def solve_plate(
    structure: EquivalentPlate,
    load_factors: Sequence[float],
    *,
    mass: float | None = None,
    links: bool = False,
    max_iterations: int = 60,
    tolerance: float = 1e-9,
) -> Dataset:
    """Solve the plate equivalent to a structure of links, with slack links at every point of it.

    Parameters
    ----------
    mass : float, optional, of every node of the structure, kg, for the first frequency
    links : bool
        Whether to evaluate ``tension`` and ``slack`` of every link, by a cell in the strain of the
        plate at the middle of its own; the groups of links of the structure must be its cells.
    max_iterations : int, largest number of Newton steps of a load factor
    tolerance : float, residual of the forces relative to the load

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``, with the nodes and links of the structure: displacements of the
        nodes; in ``slack_links`` the number of slack links, by the shares of the cells; with a mass
        the first frequency of small vibration about every step. A step that does not converge is
        NaN, and the attribute ``failure`` states the reason.

    Raises
    ------
    CaseError
        If the mass is not positive, or groups of links are not cells of the plate.
    """
    if mass is not None:
        require("mass of a node", mass, "(0, inf)", "kg")
    count = structure.members.size if links else 0  # links are refused before the first step
    limits = Limits(max_iterations, tolerance)
    u, relaxed = np.zeros(structure.plate.n), None
    rows, failures = list[dict[str, Any]](), list[str]()
    for factor in load_factors:
        begin, row = perf_counter(), dict[str, Any](converged=0)
        try:
            solution, response = _solve_step(structure, factor * structure.load, u, relaxed, limits)
            row |= {"residual": solution.residuals[-1], "iterations": len(solution.residuals)}
            solution.unwrap()
            u, relaxed = solution.value, response.relaxed
            row |= {"converged": 1, **_measure(structure, u, response, mass)}
            if links:
                row |= _link_values(structure, u)
        except MultiscaleError as error:  # also where the slack plate is a mechanism
            failures.append(f"load factor {factor:g}: {error}")
        rows.append(row | {"wall_time": perf_counter() - begin})
    # values that a failed step lacks are NaN
    shapes = {name: np.shape(value) for row in rows for name, value in row.items()}
    shapes |= {"residual": (), "displacement": structure.system.position.shape}
    shapes |= dict.fromkeys(("tension", "slack") if links else (), (count,))
    values: dict[str, Any] = {
        name: np.array([row.get(name, np.full(shape, np.nan)) for row in rows])
        for name, shape in shapes.items()
    }
    values |= {
        "load_factor": np.asarray(load_factors, dtype=float),
        "plate_stiffness": structure.cell.stiffness,
    }
    result = link_dataset(structure.system, values, step=range(len(rows)), end=range(2))
    result = result.assign_coords(strain=list(STRAINS), other_strain=list(STRAINS))
    return result.assign_attrs({"failure": "\n".join(failures)} if failures else {})


def _solve_step(
    structure: EquivalentPlate,
    load: np.ndarray,
    u: np.ndarray,
    relaxed: np.ndarray | None,
    limits: Limits,
) -> tuple[Solution, PlateResponse]:
    """Solve a load by Newton's method with a line search on the convex energy."""
    plate, cell, free = structure.plate, structure.cell, structure.free
    scale = max(norm(load[free]), norm(structure.load[free])) or 1.0
    run = NewtonRun(limits)
    while True:
        response = cell.respond(plate.strain(u), relaxed)
        relaxed = response.relaxed
        residual = (load - plate.gather(response.resultant))[free]
        K = structure.stiffness(response.tangent)
        rounding = np.finfo(float).eps * norm(abs(K) @ np.abs(u[free]))
        if not run.goes_on(float(norm(residual) / scale), float(rounding / scale)):
            return run.solution(u), response
        step = np.zeros(plate.n)
        step[free] = factorise(K, name=OF_PLATE)(residual)

        slope = partial(_slope, structure, load, u, step, relaxed)
        u = u + step_length(slope, -float(residual @ step[free])) * step


def _slope(
    structure: EquivalentPlate,
    load: np.ndarray,
    u: np.ndarray,
    step: np.ndarray,
    relaxed: np.ndarray,
    share: float,
) -> float:
    strain = structure.plate.strain(u + share * step)
    resultant = structure.cell.respond(strain, relaxed).resultant
    return float(step @ (structure.plate.gather(resultant) - load))


def _measure(
    structure: EquivalentPlate, u: np.ndarray, response: PlateResponse, mass: float | None
) -> dict[str, Any]:
    weight, free = structure.plate.weight.ravel(), structure.free
    displacement = np.stack([along @ u for along in structure.motion], axis=1)
    values = {
        "displacement": displacement,
        "largest_displacement": norm(displacement, axis=1).max(),
        "slack_links": structure.system.n_links
        * np.average(response.slack.mean(1), weights=weight),
    }
    if mass is not None:
        bending = structure.plate.geometric(response.resultant)
        K = structure.stiffness(response.tangent) + bending[free][:, free]
        motion = csr_array(vstack(structure.motion))[:, free]
        (values["first_frequency"],) = lowest_frequencies(K, mass * (motion.T @ motion), 1)
    return values


def _link_values(structure: EquivalentPlate, u: np.ndarray) -> dict[str, Any]:
    elastic = structure.elastic_tension(u)
    tension = np.clip(elastic, *structure.system.bounds)
    return {"tension": tension, "slack": np.abs(tension - elastic) / structure.system.stiffness}


def compare_with_links(result: Dataset, links: Dataset) -> Dataset:
    """Return the result of a plate with answers and distance of its links at the same loads.

    Parameters
    ----------
    result : Dataset, from :func:`solve_plate`
    links : Dataset
        The same structure from :func:`~.solve_static`, with frequencies if the plate has them.

    Returns
    -------
    Dataset
        ``result`` with ``links_displacement``, ``plate_error`` (root mean square over the nodes)
        and ``links_frequency``, NaN at steps without an answer.
    """
    u, exact = (data["displacement"].to_numpy() for data in (result, links))
    size = norm(exact, axis=(1, 2))
    values = {
        "links_displacement": norm(exact, axis=2).max(axis=1),
        "plate_error": norm(u - exact, axis=(1, 2)) / np.where(size > 0.0, size, np.nan),
    }
    if "first_frequency" in result:
        values["links_frequency"] = links["first_frequency"].to_numpy()
    return MACRO_RESULT.assign(result, values)

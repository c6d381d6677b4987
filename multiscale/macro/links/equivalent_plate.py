"""Structures of links as plates: cells in place of the links, in statics and for frequencies."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from numpy.linalg import norm
from scipy.sparse import csr_array, diags_array, eye_array, vstack
from scipy.sparse.linalg import LinearOperator, eigsh

from multiscale.convergence import Solution
from multiscale.errors import CaseError, MultiscaleError, require
from multiscale.macro.continuum.plate import UNKNOWNS, PlateElements, plate_elements
from multiscale.macro.links.link_equations import equations
from multiscale.macro.links.link_system import LinkSystem, link_dataset
from multiscale.macro.links.plate_cell import STRAINS, PlateCell, PlateResponse
from multiscale.numerics.factorisation import factorise
from multiscale.numerics.newton import Limits, NewtonRun, step_length
from multiscale.schema import MACRO_RESULT, Dataset

ON_EDGE = 1e-9  # distance from an edge, over the size of a structure, of nodes on it

OF_PLATE = "the stiffness of the structure"


@dataclass(frozen=True, eq=False)
class EquivalentPlate:
    """A rectangular structure of links that repeats a cell, as a plate.

    Loads and masses are those of the nodes of the structure, which move with the sections of the
    plate. An edge at which all nodes at z = 0 are fixed along an axis is fixed so, free to turn.

    Parameters
    ----------
    system : LinkSystem
        The whole structure, from a corner at the origin; its fixed nodes are all nodes at z = 0
        of some edges.
    cell : PlateCell
    elements : tuple of int, elements of the plate along x and y

    Raises
    ------
    CaseError
        If other nodes are fixed, or none.
    """

    system: LinkSystem
    cell: PlateCell
    elements: tuple[int, int]

    def __post_init__(self) -> None:
        fixed = np.asarray(self.system.fixed)[:, :3]
        by_edge = np.any(self._edges[..., None] & self._held[:, None], axis=0)
        low = np.abs(self.system.position[:, 2]) <= self._near
        odd = np.flatnonzero(np.any(fixed & ~(by_edge & low[:, None]), axis=1))
        if odd.size or not fixed.any():
            where = f"node {odd[0]} is fixed apart" if odd.size else "no node is fixed"
            raise CaseError(
                f"an equivalent plate is held along whole edges at z = 0, and {where}; fix all "
                f"nodes at z = 0 of an edge, and no others"
            )

    @property
    def size(self) -> tuple[float, float]:
        """Lengths along x and y, m."""
        x, y = self.system.position[:, :2].max(axis=0)
        return float(x), float(y)

    @property
    def _near(self) -> float:
        return ON_EDGE * max(self.size)

    @property
    def _edges(self) -> np.ndarray:
        """Whether nodes lie on each of the four edges, shape (4, nodes)."""
        return _on_edges(self.system.position[:, :2].T, self.size, self._near)

    @property
    def _held(self) -> np.ndarray:
        """Whether all nodes at z = 0 of each edge are fixed along each axis, shape (4, 3)."""
        low = np.abs(self.system.position[:, 2]) <= self._near
        fixed = np.asarray(self.system.fixed)[:, :3]
        return np.array([fixed[edge & low].all(axis=0) for edge in self._edges])

    @cached_property
    def plate(self) -> PlateElements:
        """Elements, with the nodes of the structure as places."""
        return plate_elements(self.size, self.elements, self.system.position[:, :2].T)

    @cached_property
    def free(self) -> np.ndarray:
        """Numbers of the unknowns of the plate that are not fixed."""
        fixed = np.zeros((self.plate.position.shape[1], UNKNOWNS), dtype=bool)
        of_plate = _on_edges(self.plate.position, self.size, self._near)
        for held, here in zip(self._held, of_plate, strict=True):
            fixed[here, :3] |= held
        return np.flatnonzero(~fixed.ravel())

    @cached_property
    def motion(self) -> list[csr_array]:
        """Operators to the displacements of the nodes of the structure along x, y and z."""
        return self.plate.section_motion(self.system.position[:, 2])

    def displacement(self, u: np.ndarray) -> np.ndarray:
        """Return the displacements of the nodes of the structure, shape (nodes, 3), m."""
        return np.stack([along @ u for along in self.motion], axis=1)

    @property
    def inertia(self) -> csr_array:
        """Mass of the free unknowns by unit masses at the nodes of the structure."""
        all_axes = csr_array(vstack(self.motion))[:, self.free]
        return csr_array(all_axes.T @ all_axes)

    @property
    def load(self) -> np.ndarray:
        """Force on the unknowns at load factor 1, N and N m."""
        pairs = zip(self.motion, self.system.load.T, strict=True)
        return np.asarray(sum(along.T @ load for along, load in pairs))

    def stiffness(self, tangent: np.ndarray) -> csr_array:
        """Assemble tangents at all points for the free unknowns."""
        return csr_array(self.plate.assemble(tangent)[self.free][:, self.free])


def _on_edges(plan: np.ndarray, size: tuple[float, float], near: float) -> np.ndarray:
    """Whether positions of shape (2, points) lie on each edge of a rectangle, shape (4, points)."""
    return np.array([np.abs(plan[k] - end) <= near for k in range(2) for end in (0.0, size[k])])


def solve_plate(
    structure: EquivalentPlate,
    load_factors: Sequence[float],
    *,
    mass: float | None = None,
    max_iterations: int = 60,
    tolerance: float = 1e-9,
) -> Dataset:
    """Solve the plate equivalent to a structure of links, with slack links at every point of it.

    Parameters
    ----------
    structure : EquivalentPlate
    load_factors : sequence of float
    mass : float, optional, of every node of the structure, kg, for the first frequency
    max_iterations : int, largest number of Newton steps of a load factor
    tolerance : float, residual of the forces relative to the load

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``, with the nodes and links of the structure: displacements of the
        nodes; in ``slack_links`` the number of slack links, by the shares of the cells; with a mass
        the first frequency of small vibration about every step. A step that does not converge is
        NaN, and the attribute ``failure`` states the reason.
    """
    factors, plate = np.asarray(load_factors, dtype=float), structure.plate
    load, limits = structure.load, Limits(max_iterations, tolerance)
    state = _State(np.zeros(plate.n), None)
    rows, failures = [], list[str]()
    for factor in factors:
        begin, row = perf_counter(), dict[str, Any](converged=0)
        try:
            solution, state = _solve_step(structure, factor * load, state, limits)
            reason = "" if solution.converged else solution.status.value
            row |= {"residual": solution.residuals[-1], "iterations": len(solution.residuals)}
            if not reason:
                row |= {"converged": 1, **_measure(structure, state, mass)}
        except MultiscaleError as error:  # the plate is a mechanism
            reason = str(error)
        if reason:
            failures.append(f"load factor {factor:g}: {reason}")
        rows.append(row | {"wall_time": perf_counter() - begin})
    result = _join(structure, factors, rows)
    return result.assign_attrs({"failure": "\n".join(failures)} if failures else {})


class _State(NamedTuple):
    """Unknowns of the plate, and the response of its cells."""

    u: np.ndarray
    response: PlateResponse | None


def _solve_step(
    structure: EquivalentPlate, load: np.ndarray, state: _State, limits: Limits
) -> tuple[Solution, _State]:
    """Solve a load by Newton's method with a line search on the convex energy."""
    plate, cell, free = structure.plate, structure.cell, structure.free
    scale = max(norm(load[free]), norm(structure.load[free])) or 1.0
    run, u, response = NewtonRun(limits), state.u, state.response
    while True:
        near = None if response is None else response.relaxed
        response = cell.respond(plate.strain(u), near)
        residual = (load - plate.gather(response.resultant))[free]
        if not run.goes_on(float(norm(residual) / scale)):
            return run.solution(u), _State(u, response)
        step = np.zeros(plate.n)
        step[free] = factorise(structure.stiffness(response.tangent), name=OF_PLATE)(residual)

        slope = partial(_slope, structure, load, u, step, response.relaxed)
        u = u + step_length(slope, -float(residual @ step[free])) * step


def _slope(
    structure: EquivalentPlate,
    load: np.ndarray,
    u: np.ndarray,
    step: np.ndarray,
    relaxed: np.ndarray,
    share: float,
) -> float:
    """Return the derivative of the energy along a step, after a share of it, J."""
    strain = structure.plate.strain(u + share * step)
    resultant = structure.cell.respond(strain, relaxed).resultant
    return float(step @ (structure.plate.gather(resultant) - load))


def _measure(structure: EquivalentPlate, state: _State, mass: float | None) -> dict[str, Any]:
    """Return the answers of a step that converged."""
    assert state.response is not None
    weight, moved = structure.plate.weight.ravel(), structure.displacement(state.u)
    share = weight @ state.response.slack.mean(axis=1) / weight.sum()
    values = {
        "displacement": moved,
        "largest_displacement": norm(moved, axis=1).max(),
        "slack_links": share * structure.system.n_links,
    }
    if mass is None:
        return values
    stiffness = structure.stiffness(state.response.tangent)
    return values | {"plate_frequency": _first_frequency(stiffness, mass * structure.inertia)}


def _join(
    structure: EquivalentPlate, factors: np.ndarray, rows: Sequence[dict[str, Any]]
) -> Dataset:
    """Join the steps; values that a failed step lacks are NaN."""
    shapes = {name: np.shape(value) for row in rows for name, value in row.items()}
    shapes |= {"residual": (), "displacement": structure.system.position.shape}
    values = {
        name: np.array([row.get(name, np.full(shape, np.nan)) for row in rows])
        for name, shape in shapes.items()
    }
    values |= {"load_factor": factors, "plate_stiffness": structure.cell.stiffness}
    result = link_dataset(structure.system, values, step=range(factors.size), end=range(2))
    return result.assign_coords(strain=list(STRAINS), other_strain=list(STRAINS))


def link_frequency(system: LinkSystem, mass: float, slack: np.ndarray) -> float:
    """Return the first frequency of links with a mass at every node, kg, in Hz.

    Slack links, by a mask of shape (links,), have no stiffness.
    """
    require("mass of a node", mass, "(0, inf)", "kg")
    model = equations(system)
    K = model.operator.T @ diags_array(model.finite_stiffness * ~slack) @ model.operator
    return _first_frequency(csr_array(K), mass * eye_array(model.n, format="csr"))


def with_links(result: Dataset, links: Dataset, mass: float | None, system: LinkSystem) -> Dataset:
    """Return the result of a plate with answers and distance of its links at the same loads.

    Steps without an answer of the links are NaN; ``links`` is of :func:`~.solve_static`.
    """
    u, exact = (found["displacement"].to_numpy() for found in (result, links))
    size = norm(exact, axis=(1, 2))
    values = {
        "links_displacement": norm(exact, axis=2).max(axis=1),
        "plate_error": norm(u - exact, axis=(1, 2)) / np.where(size > 0.0, size, np.nan),
    }
    if mass is not None:
        slack, solved = links["slack"].to_numpy() > 0.0, links["converged"].to_numpy() == 1
        values["links_frequency"] = np.array(
            [
                link_frequency(system, mass, mask) if known else np.nan
                for mask, known in zip(slack, solved, strict=True)
            ]
        )
    return MACRO_RESULT.assign(result, values)


def _first_frequency(stiffness: csr_array, mass: csr_array) -> float:
    """Return the first frequency of a structure, in Hz."""
    n = stiffness.shape[0]
    inverse = LinearOperator((n, n), matvec=factorise(stiffness, name=OF_PLATE), dtype=float)
    start = np.random.default_rng(seed=0).standard_normal(n)
    (value,) = eigsh(
        stiffness, 1, M=mass, sigma=0.0, OPinv=inverse, v0=start, return_eigenvectors=False
    )
    return float(np.sqrt(value)) / (2.0 * np.pi)

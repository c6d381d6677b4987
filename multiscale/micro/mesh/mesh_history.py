r"""Cells on meshes that remember their path: they flow, or rub against a rigid flat.

The equations of an increment are the ones of a cell at large strain, for any element. A metal is J2
in logarithmic strain, which at small strain is the classical return map. Newton's matrix is
assembled and factorised. With the internal forces f, their tangent T, the weight
:math:`\rho_t`, the direction a of the trial friction force and b across it, its rows are

.. math::
    &T_z\, \mathrm{d}u \;\to\; \mathrm{d}u_z + \mathrm{d}\delta = g
        && \text{in contact,} \\
    &T_t\, \mathrm{d}u \;\to\; \mathrm{d}u_t = -w_t && \text{sticking,} \\
    &T_t\, \mathrm{d}u \;\to\; (T_t + \mu\, a\, T_z + \rho_t s\, b\, b^T)\, \mathrm{d}u
        && \text{slipping,}    \tag{1}

with the gap g, the slip w since the start and the stretch s.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from multiscale.errors import CaseError, MultiscaleError
from multiscale.fe.elements import element_response, elements_of_basis
from multiscale.laws.bulk import J2
from multiscale.micro.averages import ContactSurface, to_components
from multiscale.micro.finite.finite_cell import HistoryModel, plastic_approach
from multiscale.micro.finite.scene import (
    BodyResponse,
    CellScene,
    CellState,
    FiniteBody,
    Increment,
)
from multiscale.micro.finite.surfaces import OppositeSide
from multiscale.micro.mesh.elastic_mesh import ElasticMesh, assemble_elastic_mesh
from multiscale.micro.mesh.mesh_cell import MeshCell
from multiscale.micro.mesh.unknowns import strained_weight
from multiscale.micro.path import Path
from multiscale.numerics.factorisation import factorise
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    from multiscale.micro.finite.equations import Iterate

__all__ = ["assemble_mesh_history"]

TANGENTIAL_WEIGHT = 0.3  # of slip, over the stiffness of a node


@dataclass(frozen=True, eq=False)
class _Layout:
    """Displacements (nodes, 3), contact nodes first, of the unknowns of a cell.

    Attributes
    ----------
    slot : ndarray of int, shape (unknowns,)
        Place of every unknown among the components of the nodes.
    nodes, contacts : int, numbers of nodes
    """

    slot: np.ndarray
    nodes: int
    contacts: int

    def gather(self, u: np.ndarray) -> np.ndarray:
        """Unknowns of a displacement."""
        return np.asarray(u.reshape(-1)[self.slot])

    def spread(self, v: np.ndarray) -> np.ndarray:
        """Displacement of the unknowns, or a force; zero where nothing moves."""
        u = np.zeros((self.nodes, 3))
        u.reshape(-1)[self.slot] = v
        return u


def _layout(mesh: ElasticMesh) -> _Layout:
    node, component = np.divmod(mesh.unknowns.place, 3)
    first = mesh.unknowns.nodes
    order = np.concatenate([first, np.setdiff1d(node, first)])
    position = np.empty(mesh.basis.N, dtype=int)
    position[order] = np.arange(len(order))
    return _Layout(3 * position[node] + component, len(order), len(first))


@dataclass(frozen=True, eq=False)
class _Factors:
    """Linear solver of a cell on a mesh, by factors of the assembled tangent.

    Attributes
    ----------
    mesh : ElasticMesh, the elastic cell, for the first touch of an open cell
    layout : _Layout
    """

    mesh: ElasticMesh
    layout: _Layout

    def touch(self, gap: np.ndarray, closing: np.ndarray, load: float) -> tuple[np.ndarray, float]:
        """Press the elastic body under a load, N; see :class:`.LinearSolver`."""
        elastic = self.mesh.problem.solve(load=load)
        return elastic.active[:, None], elastic.approach

    def step(self, now: "Iterate", forcing: float, floor: float) -> tuple[np.ndarray, float, int]:
        """Solve the linear problem (1) of a Newton step by factors."""
        number, T = self.mesh.unknowns.number, now.response.matrix
        assert T is not None
        active, sticks, slips = (
            mask[:, 0] for mask in (now.active, now.sticking, now.slipping & now.active)
        )
        size = T.shape[0]
        keep, own = np.ones(size), np.zeros(size)
        right = -self.layout.gather(now.residual)
        scale = float(np.abs(T.diagonal()).mean())  # makes rows of motions comparable
        keep[number[active, 2]] = 0.0
        own[number[active, 2]] = scale
        right[number[active, 2]] = scale * now.meeting.gap[active, 0]
        rows, columns, values = [np.arange(size)], [np.arange(size)], [keep]
        more: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        if now.friction is not None:
            held = number[sticks, :2]
            keep[held], own[held] = 0.0, scale
            right[held] = -scale * now.friction.slip[..., 0][sticks, :2]
            along, across = now.friction.direction[..., 0][:, slips, :2]
            stretch = now.scene.weights[1] * now.friction.stretch[slips, 0]
            for i in range(2):
                rows.append(number[slips, i])
                columns.append(number[slips, 2])
                values.append(now.scene.friction * along[:, i])
                more += [
                    (number[slips, i], number[slips, j], stretch * across[:, i] * across[:, j])
                    for j in range(2)
                ]
        exchange = sparse.csr_array(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), T.shape
        )
        entries = [(np.arange(size), np.arange(size), own), *more]
        at_row, at_column, added = (np.concatenate(part) for part in zip(*entries, strict=True))
        motions = sparse.csr_array((added, (at_row, at_column)), T.shape)
        matrix = sparse.csr_array(exchange @ T + motions)
        try:
            solve = factorise(matrix, name="Newton's matrix of the cell")
        except MultiscaleError:  # no equilibrium near this iterate: a shorter increment is taken
            return np.full_like(now.u, np.nan), 0.0, 1
        if now.target.load is None:
            return self.layout.spread(solve(right)).ravel(), 0.0, 1
        lifted = np.zeros(size)  # by a unit of the approach
        lifted[number[active, 2]] = scale
        moved, shifted = solve(np.stack([right, lifted], axis=1)).T
        carried = T[number[active, 2]].sum(axis=0)
        shift = (carried @ moved - now.missing) / (carried @ shifted)
        return self.layout.spread(moved - shift * shifted).ravel(), float(shift), 2


@dataclass(frozen=True, eq=False)
class MeshModel(HistoryModel):
    """Model of a cell on a mesh that flows or rubs.

    Attributes
    ----------
    cell : MeshCell
    mesh : ElasticMesh
    layout : _Layout
    """

    cell: MeshCell
    mesh: ElasticMesh
    layout: _Layout

    def surface(self, state: CellState) -> ContactSurface:
        """Contact surface of a state in the current configuration."""
        cell, mesh = self.cell, self.mesh
        v, force = self.layout.gather(state.displacement), state.force[:, :, 0]
        moved = (mesh.unknowns.expand @ v).reshape(-1, 3)
        problem, at_contact = mesh.problem, mesh.unknowns.coefficients @ moved
        weight = problem.node_area
        if cell.law.finite_strain:
            weight = strained_weight(cell, mesh.basis, mesh.unknowns, moved.T)
        gap = problem.obstacle_height - state.approach - (problem.surface_height + at_contact[:, 2])
        mean = to_components(problem.node_area @ at_contact) / self.area
        surface = ContactSurface(
            force,
            problem.normal,
            np.where(state.active[:, 0], -force[:, 2], 0.0),
            gap,
            problem.node_area,
            weight,
            np.array([-state.approach, *state.slide]) - mean,
            float(np.sum(weight * gap) / np.sum(weight)),
            flowing=cell.law.flows,
            slip=self.slip(state),
            flowing_share=state.flowing if cell.law.flows else None,
        )
        return problem.arrange(surface)


def assemble_mesh_history(cell: MeshCell, path: Path) -> MeshModel:
    """Set up the scene of a cell that flows or has friction, for a path."""
    if path.time is not None:
        raise CaseError(
            "the path has times, but the body has no viscosity and its answer no rate; leave out "
            "time"
        )
    mesh = assemble_elastic_mesh(cell)
    largest = np.inf
    if cell.law.flows:
        largest = plastic_approach(float(np.ptp(mesh.problem.surface_height)), path.refinement)
    layout = _layout(mesh)
    scene = _scene(cell, mesh, layout)
    return MeshModel(scene, mesh.problem.area, largest, path.increments, cell, mesh, layout)


def _scene(cell: MeshCell, mesh: ElasticMesh, layout: _Layout) -> CellScene:
    heights = Surface(mesh.problem.surface_height[:, None], (1.0, 1.0))
    vertical = mesh.stiffness.diagonal()[mesh.unknowns.number[:, 2]]
    weight = float(np.median(vertical))
    return CellScene(
        (_body(cell, mesh, layout),),
        OppositeSide(heights, None, follows=False),
        cell.friction_coefficient,
        (weight, TANGENTIAL_WEIGHT * weight),
        _Factors(mesh, layout),
    )


def _body(cell: MeshCell, mesh: ElasticMesh, layout: _Layout) -> FiniteBody:
    """Return the body of a cell; elements of first order take the mean change of volume."""
    shape = (layout.nodes, 3)

    def surface(u: np.ndarray) -> np.ndarray:
        return u[: layout.contacts, :, None]

    if not isinstance(cell.law, J2):

        def stretch(u: np.ndarray) -> BodyResponse:
            force = layout.spread(mesh.stiffness @ layout.gather(u))
            return BodyResponse(force, mesh.stiffness.__matmul__, 1.0, 0.0, mesh.stiffness)

        same = Increment(stretch, lambda u: None)
        return FiniteBody(shape, lambda state, time_step: same, lambda: None, surface)
    law, expand = cell.law, mesh.unknowns.expand
    elements = elements_of_basis(mesh.basis, mean_volume=cell.element.maxdeg <= 3)

    def begin(state: np.ndarray, time_step: float) -> Increment:
        def evaluate(u: np.ndarray) -> tuple[np.ndarray, Any, np.ndarray, float]:
            return element_response(elements, law, expand @ layout.gather(u), state)

        def respond(u: np.ndarray) -> BodyResponse:
            force, tangent, new, least = evaluate(u)
            flowing = float(np.mean(new[6] > state[6]))
            if not least > 0.0:  # an element is turned inside out
                return BodyResponse(np.full(shape, np.nan), np.copy, least, flowing)
            own = sparse.csr_array(expand.T @ tangent @ expand)
            return BodyResponse(
                layout.spread(expand.T @ force), own.__matmul__, least, flowing, own
            )

        return Increment(respond, lambda u: evaluate(u)[2])

    return FiniteBody(shape, begin, lambda: law.initial_state(elements.weight.shape), surface)

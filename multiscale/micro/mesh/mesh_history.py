r"""Cells on meshes with history: plastic flow, or friction against a rigid flat.

With the internal forces f, their tangent T, the weight :math:`\rho_t`, the direction a of the trial
friction force and b across it, the gap g, the slip w since the start and the relative resistance s
across the slip, the rows of Newton's matrix are

.. math::
    &T_z\, \mathrm{d}u \;\to\; \mathrm{d}u_z + \mathrm{d}\delta = g
        && \text{in contact,} \\
    &T_t\, \mathrm{d}u \;\to\; \mathrm{d}u_t = -w_t && \text{sticking,} \\
    &T_t\, \mathrm{d}u \;\to\; (T_t + \mu\, a\, T_z + \rho_t s\, b\, b^T)\, \mathrm{d}u
        && \text{slipping.}    \tag{1}
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from multiscale.errors import CaseError, MultiscaleError
from multiscale.fe.elasticity import Elements, element_response, elements_of_basis
from multiscale.laws.bulk import J2
from multiscale.micro.averages import ContactSurface, to_components
from multiscale.micro.finite.equations import (
    BodyResponse,
    CellScene,
    CellState,
    FiniteBody,
    Iterate,
    Respond,
)
from multiscale.micro.finite.finite_cell import HistoryModel, plastic_approach
from multiscale.micro.finite.surfaces import OppositeSide
from multiscale.micro.layer import Linear
from multiscale.micro.mesh.unknowns import ElasticMesh, strained_weight
from multiscale.micro.path import Path
from multiscale.numerics.factorisation import factorise
from multiscale.surfaces.surface import Surface

TANGENTIAL_WEIGHT = 0.3  # of slip, over the stiffness of a node


@dataclass(frozen=True, eq=False)
class _MeshBody(FiniteBody):
    """Elastic or plastic body with displacements, shape (nodes, 3), contact nodes first."""

    mesh: ElasticMesh
    law: Linear | J2
    shape: tuple[int, ...]
    slot: np.ndarray  # (unknowns,), place of every unknown among the components of the nodes

    @classmethod
    def of(cls, mesh: ElasticMesh, law: Linear | J2) -> "_MeshBody":
        node, component = np.divmod(mesh.unknowns.place, 3)
        first = mesh.unknowns.nodes
        order = np.concatenate([first, np.setdiff1d(node, first)])
        position = np.empty(mesh.basis.N, dtype=int)
        position[order] = np.arange(len(order))
        return cls(mesh, law, (len(order), 3), 3 * position[node] + component)

    def surface(self, displacement: np.ndarray) -> np.ndarray:
        return displacement[: len(self.mesh.unknowns.nodes), :, None]

    def gather(self, u: np.ndarray) -> np.ndarray:
        """Return the unknowns of a displacement."""
        return np.asarray(u.reshape(-1)[self.slot])

    def spread(self, v: np.ndarray) -> np.ndarray:
        """Return the displacement, or force, of the unknowns; zero at fixed components."""
        u = np.zeros(self.shape)
        u.reshape(-1)[self.slot] = v
        return u

    @cached_property
    def _elements(self) -> Elements:
        """Elements of a metal; elements of first order use their mean change of volume."""
        return elements_of_basis(self.mesh.basis, mean_volume=self.mesh.basis.elem.maxdeg <= 3)

    def rest(self) -> np.ndarray | None:
        law = self.law
        return law.initial_state(self._elements.weight.shape) if isinstance(law, J2) else None

    def begin(self, state: np.ndarray, time_step: float) -> Respond:
        law, expand, stiffness = self.law, self.mesh.unknowns.expand, self.mesh.stiffness

        def stretch(u: np.ndarray) -> BodyResponse:
            force, multiply = self.spread(stiffness @ self.gather(u)), stiffness.__matmul__
            return BodyResponse(force, multiply, matrix=stiffness)

        if not isinstance(law, J2):
            return stretch

        def flow(u: np.ndarray) -> BodyResponse:
            moved = expand @ self.gather(u)
            force, tangent, new, least = element_response(self._elements, law, moved, state)
            flowing = float(np.mean(new[6] > state[6]))
            if not least > 0.0:  # an element is turned inside out
                nothing = np.full(self.shape, np.nan)
                return BodyResponse(nothing, np.copy, lambda: new, least, flowing)
            matrix = sparse.csr_array(expand.T @ tangent @ expand)
            force = self.spread(expand.T @ force)
            return BodyResponse(force, matrix.__matmul__, lambda: new, least, flowing, matrix)

        return flow


@dataclass(frozen=True, eq=False)
class _Factors:
    """Linear solver of a cell on a mesh, by factors of the assembled tangent."""

    body: _MeshBody

    def touch(self, gap: np.ndarray, closing: np.ndarray, load: float) -> tuple[np.ndarray, float]:
        """Press the elastic body under a load, N; see :class:`.LinearSolver`."""
        elastic = self.body.mesh.problem.solve(load=load)
        return elastic.active[:, None], elastic.approach

    def step(self, now: Iterate, forcing: float, floor: float) -> tuple[np.ndarray, float, int]:
        """Solve the linear problem (1) of a Newton step by factors."""
        number, T = self.body.mesh.unknowns.number, now.response.matrix
        assert T is not None
        active, sticks, slips = (
            mask[:, 0] for mask in (now.active, now.sticking, now.slipping & now.active)
        )
        # rows of nodes in contact: gap closed
        size = T.shape[0]
        keep, diagonal = np.ones(size), np.zeros(size)
        right = -self.body.gather(now.residual)
        scale = float(np.abs(T.diagonal()).mean())  # makes rows of motions comparable
        keep[number[active, 2]] = 0.0
        diagonal[number[active, 2]] = scale
        right[number[active, 2]] = scale * now.meeting.gap[active, 0]
        rows, columns, values = [np.arange(size)], [np.arange(size)], [keep]
        more: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        # rows of sticking and slipping nodes
        if now.friction is not None:
            fixed = number[sticks, :2]
            keep[fixed], diagonal[fixed] = 0.0, scale
            right[fixed] = -scale * now.friction.slip[..., 0][sticks, :2]
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
        # Newton's matrix
        exchange = sparse.csr_array(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), T.shape
        )
        entries = [(np.arange(size), np.arange(size), diagonal), *more]
        at_row, at_column, added = map(np.concatenate, zip(*entries, strict=True))
        motions = sparse.csr_array((added, (at_row, at_column)), T.shape)
        matrix = sparse.csr_array(exchange @ T + motions)
        try:
            solve = factorise(matrix, name="Newton's matrix of the cell")
        except MultiscaleError:  # no equilibrium near this iterate: a shorter increment is taken
            return np.full_like(now.u, np.nan), 0.0, 1
        if now.target.load is None:
            return self.body.spread(solve(right)).ravel(), 0.0, 1
        # under a load: the approach that balances the vertical force
        lifted = np.zeros(size)  # a unit of the approach
        lifted[number[active, 2]] = scale
        moved, shifted = solve(np.stack([right, lifted], axis=1)).T
        carried = T[number[active, 2]].sum(axis=0)
        shift = (carried @ moved - now.missing) / (carried @ shifted)
        return self.body.spread(moved - shift * shifted).ravel(), float(shift), 2


@dataclass(frozen=True, eq=False)
class MeshModel(HistoryModel):
    """Model of a cell on a mesh with plastic flow or friction."""

    body: _MeshBody

    def surface(self, state: CellState) -> ContactSurface:
        """Contact surface of a state in the current configuration."""
        law, mesh = self.body.law, self.body.mesh
        v, force = self.body.gather(state.displacement), state.force[:, :, 0]
        moved = (mesh.unknowns.expand @ v).reshape(-1, 3)
        problem, at_contact = mesh.problem, mesh.unknowns.coefficients @ moved
        weight = problem.node_area
        if law.finite_strain:
            weight = strained_weight(mesh.basis, mesh.unknowns, moved.T)
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
            flowing=law.flows,
            slip=self.slip(state),
            flowing_share=state.flowing if law.flows else None,
        )
        return problem.arrange(surface)


def assemble_mesh_history(
    mesh: ElasticMesh, law: Linear | J2, friction: float, path: Path
) -> MeshModel:
    """Set up the model of a cell with plastic flow or friction, for a path."""
    if path.time is not None:
        raise CaseError(
            "the path has times, but the body is not viscous and does not depend on time; leave "
            "out time"
        )
    largest = np.inf
    if law.flows:
        largest = plastic_approach(float(np.ptp(mesh.problem.surface_height)), path.refinement)
    body = _MeshBody.of(mesh, law)
    heights = Surface(mesh.problem.surface_height[:, None], (1.0, 1.0))
    weight = float(np.median(mesh.stiffness.diagonal()[mesh.unknowns.number[:, 2]]))
    scene = CellScene(
        (body,),
        OppositeSide(heights, None, follows=False),
        friction,
        (weight, TANGENTIAL_WEIGHT * weight),
        _Factors(body),
    )
    return MeshModel(scene, mesh.problem.area, largest, path.increments, body)

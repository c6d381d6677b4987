"""Bodies of any bulk law in contact, at small or large displacement, under one numbering."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array, diags_array, kron, vstack

from multiscale.errors import CaseError
from multiscale.fe.elements import Elements, element_response, prepare_elements, sum_blocks
from multiscale.fe.faces import face_areas
from multiscale.fe.facets import surface_of
from multiscale.laws.bulk import BulkLaw, BulkResponse
from multiscale.macro.continuum.body import Body, fixed_motion, load_vector
from multiscale.macro.continuum.interface import (
    Contact,
    ContactInterface,
    Coupling,
    build_coupling,
    fit,
    local_jump,
    slip_operator,
)
from multiscale.macro.continuum.rigid_obstacle import obstacle_motion
from multiscale.numerics.factorisation import on_diagonal

__all__ = ["FiniteAssembly", "JoinedContacts"]


@dataclass(frozen=True)
class JoinedContacts:
    """All interfaces in one configuration, one node after the other.

    Attributes
    ----------
    operator : csr_array, shape (nodes * c, unknowns)
        Weighted jump in the local frames, B, m²; its transpose times the reaction is H r.
    tangent : csr_array, shape (nodes * c, unknowns)
        Derivative of the weighted jump: slip takes the partners of the step before.
    area, kept
        As in :class:`Coupling`, of all interfaces.
    """

    operator: csr_array
    tangent: csr_array
    area: np.ndarray
    kept: np.ndarray


@dataclass(frozen=True)
class FiniteAssembly:
    r"""Bodies of any bulk law and the contacts between them: the source's problem (4)-(5).

    Displacements, strains and sliding may be large. Unknown d a + i is component i of node a,
    counted over all bodies; :func:`solve_contact` finds its equilibria.

    Parameters
    ----------
    bodies : mapping of str to Body, all of two or all of three dimensions
    contacts : mapping of str to Contact

    Raises
    ------
    CaseError
        If a contact names an unknown body or boundary, no body has a support, or a body has
        neither support nor contact.
    """

    bodies: Mapping[str, Body]
    contacts: Mapping[str, Contact] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.bodies:
            raise CaseError("a contact problem needs at least one body")
        dims = {name: body.mesh.dim() for name, body in self.bodies.items()}
        if len(set(dims.values())) > 1:
            raise CaseError(f"all bodies must have the same number of dimensions, got {dims}")
        touched = set()
        for name, contact in self.contacts.items():
            for side in contact.surfaces:
                if side[0] not in self.bodies:
                    raise CaseError(
                        f"contact {name!r} names no body of the problem: {side[0]!r}; "
                        f"its bodies are {sorted(self.bodies)}"
                    )
                self.bodies[side[0]].check_boundary(side[1])
                touched.add(side[0])
            if contact.side1 == contact.side2:
                raise CaseError(f"both sides of contact {name!r} are the same surface")
        if not any(body.supports or body.pins for body in self.bodies.values()):
            raise CaseError("no body has a support; hold one of them by its supports")
        for name, body in self.bodies.items():
            if body.element is not None:
                raise CaseError(
                    f"body {name!r} has an element of its own, {type(body.element).__name__}; "
                    f"contact at large displacement takes the corners of the mesh as nodes"
                )
            if not (body.supports or body.pins) and name not in touched:
                raise CaseError(
                    f"body {name!r} has neither a support nor a contact; give it one of them"
                )

    @cached_property
    def first(self) -> np.ndarray:
        """First node of each body, and the number of nodes."""
        return np.cumsum([0] + [body.mesh.p.shape[1] for body in self.bodies.values()])

    @cached_property
    def start(self) -> np.ndarray:
        """Undeformed positions, shape (nodes, d), m."""
        return np.concatenate([body.mesh.p.T for body in self.bodies.values()])

    @cached_property
    def free(self) -> np.ndarray:
        """Unknowns that no support holds, shape (unknowns,)."""
        free = np.ones(self.start.size, dtype=bool)
        for k, body in enumerate(self.bodies.values()):
            free[self.unknowns(k)][fixed_motion(body, 0.0)[0]] = False
        return free

    @cached_property
    def elements(self) -> tuple[Elements, ...]:
        """Elements of each body."""
        return tuple(prepare_elements(body.mesh) for body in self.bodies.values())

    @cached_property
    def linear(self) -> tuple[csr_array | None, ...]:
        """Constant stiffness of each body, N/m; None at finite strain."""
        return tuple(
            None if body.law.finite_strain else _stiffness(elements, body.law)
            for body, elements in zip(self.bodies.values(), self.elements, strict=True)
        )

    @cached_property
    def interfaces(self) -> tuple[ContactInterface, ...]:
        """Contacts with the numbers of their nodes."""
        names, interfaces = list(self.bodies), []
        for name, contact in self.contacts.items():
            surfaces = tuple(
                surface_of(self.bodies[b].mesh, boundary) for b, boundary in contact.surfaces
            )
            nodes = tuple(
                surface.nodes + self.first[names.index(b)]
                for surface, (b, _) in zip(surfaces, contact.surfaces, strict=True)
            )
            one = nodes[0]
            corner, _, area = face_areas(self.bodies[contact.side1[0]].basis, contact.side1[1])
            area = np.bincount(corner, area)[surfaces[0].nodes]
            free = self.free.reshape(self.start.shape)[one]
            offset = np.zeros(len(one))
            interface = ContactInterface(name, contact, surfaces, nodes, area, free, offset)
            interfaces.append(fit(interface, self.start))
        return tuple(interfaces)

    @cached_property
    def friction(self) -> np.ndarray:
        """Coefficient of friction of every contact node."""
        return np.concatenate(
            [np.zeros(0)]
            + [
                np.full(len(interface.nodes[0]), interface.contact.friction_coefficient)
                for interface in self.interfaces
            ]
        )

    @cached_property
    def contact_nodes(self) -> tuple[slice, ...]:
        """Contact nodes of each interface, which are the nodes of its side 1."""
        end = np.cumsum([0] + [len(interface.nodes[0]) for interface in self.interfaces])
        return tuple(slice(a, b) for a, b in pairwise(end))

    @property
    def components(self) -> int:
        """Unknowns of a contact node: 1 if no contact has friction, else d."""
        return self.start.shape[1] if self.friction.any() else 1

    @cached_property
    def diagonal(self) -> np.ndarray:
        """Diagonal of the first stiffness, shape (unknowns,), N/m, zero where a support holds.

        It lacks the resistance to a change of volume: this is what a contact node feels, of nearly
        incompressible bodies too.
        """
        diagonal = np.concatenate(
            [
                _stiffness(elements, _ShapeAlone(body.law)).diagonal()
                for body, elements in zip(self.bodies.values(), self.elements, strict=True)
            ]
        )
        return np.where(self.free, diagonal, 0.0)

    @property
    def is_linear(self) -> bool:
        """Whether everything but the contact law is linear."""
        moving = any(interface.contact.finite_sliding for interface in self.interfaces)
        return not moving and all(matrix is not None for matrix in self.linear)

    def unknowns(self, body: int) -> slice:
        """Unknowns of a body."""
        d = self.start.shape[1]
        return slice(d * self.first[body], d * self.first[body + 1])

    def supported(self, time: float) -> np.ndarray:
        """Displacement of the unknowns that supports hold, in their order, m."""
        return np.concatenate([fixed_motion(body, time)[1] for body in self.bodies.values()])

    def load(self, time: float) -> np.ndarray:
        """External forces, N."""
        return np.concatenate([load_vector(body, time) for body in self.bodies.values()])

    def initial_state(self) -> tuple[np.ndarray, ...]:
        """Undeformed state of all bodies."""
        bodies = self.bodies.values()
        return tuple(
            body.law.initial_state(elements.weight.shape)
            for body, elements in zip(bodies, self.elements, strict=True)
        )

    def internal(
        self, u: np.ndarray, state: tuple[np.ndarray, ...]
    ) -> tuple[np.ndarray, csr_array, tuple[np.ndarray, ...], float]:
        """Compute internal forces (N), tangent (N/m), new state and smallest volume ratio."""
        forces, matrices, states, smallest = [], [], [], np.inf
        for k, body in enumerate(self.bodies.values()):
            part, linear = u[self.unknowns(k)], self.linear[k]
            if linear is not None:
                forces.append(linear @ part)
                matrices.append(linear)
                states.append(state[k])
                continue
            force, matrix, new, ratio = element_response(self.elements[k], body.law, part, state[k])
            forces.append(force)
            matrices.append(matrix)
            states.append(new)
            smallest = min(smallest, ratio)
        tangent = on_diagonal(matrices)
        return np.concatenate(forces), tangent, tuple(states), smallest

    def couplings(
        self, u: np.ndarray, time: float, old: tuple[Coupling, ...] | None
    ) -> tuple[Coupling, ...]:
        """Couplings at a displacement; couplings of small sliding stay as they are."""
        d = self.start.shape[1]
        x = self.start + u.reshape(-1, d)
        result = []
        for k, interface in enumerate(self.interfaces):
            moving = interface.contact.finite_sliding
            if old is not None and not moving:
                result.append(old[k])
                continue
            obstacle, shift = interface.contact.obstacle, np.zeros(d)
            if moving and obstacle is not None:
                shift = obstacle_motion(obstacle, d, time)
            result.append(build_coupling(interface, x if moving else self.start, shift))
        return tuple(result)

    def join(self, before: tuple[Coupling, ...], couplings: tuple[Coupling, ...]) -> JoinedContacts:
        """Stack couplings of the step before and now; without friction only the normal rows."""
        c, d = self.components, self.start.shape[1]
        nothing = csr_array((0, self.start.size))
        rows, tangents = [nothing], [nothing]
        areas, kept = [np.zeros(0)], [np.zeros((0, c), bool)]
        for interface, old, coupling in zip(self.interfaces, before, couplings, strict=True):
            n = len(coupling.area)
            frame = coupling.frame[:, :c]
            i, j = np.arange(n * c).reshape(n, c), np.arange(n * d).reshape(n, d)
            turn = sum_blocks(frame, i, j, (n * c, n * d))
            now = turn @ kron(coupling.operator, np.eye(d), format="csr")
            rows.append(now)
            if c > 1 and interface.follows:
                along = diags_array((np.arange(n * c) % c > 0).astype(float))
                slip = turn @ kron(slip_operator(old, coupling), np.eye(d), format="csr")
                now = now + along @ (slip - now)
            tangents.append(now)
            areas.append(coupling.area)
            kept.append(coupling.kept[:, :c])
        return JoinedContacts(
            csr_array(vstack(rows)),
            csr_array(vstack(tangents)),
            np.concatenate(areas),
            np.concatenate(kept),
        )

    def jump(
        self,
        before: tuple[Coupling, ...],
        couplings: tuple[Coupling, ...],
        motion: tuple[np.ndarray, np.ndarray],
        times: tuple[float, float],
    ) -> np.ndarray:
        """Gap and slip of a step at all contact nodes, shape (contact nodes, c), m."""
        d = self.start.shape[1]
        fields = (motion[0].reshape(-1, d), motion[1].reshape(-1, d))
        parts = [
            local_jump(interface, (old, now), self.start, fields, times)[:, : self.components]
            for interface, old, now in zip(self.interfaces, before, couplings, strict=True)
        ]
        return np.concatenate([np.zeros((0, self.components)), *parts])


@dataclass(frozen=True)
class _ShapeAlone(BulkLaw):
    """A law without its resistance to a change of volume."""

    law: BulkLaw

    @property
    def finite_strain(self) -> bool:  # type: ignore[override]
        """As the law."""
        return self.law.finite_strain

    def initial_state(self, shape: tuple[int, ...]) -> np.ndarray:
        """As the law."""
        return self.law.initial_state(shape)

    def respond_shape(self, gradient: np.ndarray, state: np.ndarray) -> BulkResponse:
        """As the law."""
        return self.law.respond_shape(gradient, state)

    def respond_volume(self, dilatation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """No resistance."""
        nothing = np.zeros_like(dilatation)
        return nothing, nothing


def _stiffness(elements: Elements, law: BulkLaw) -> csr_array:
    """Stiffness of an undeformed body, N/m."""
    rest = law.initial_state(elements.weight.shape)
    return element_response(elements, law, np.zeros(elements.size), rest)[1]

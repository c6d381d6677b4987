"""Bodies of any bulk law in contact, at small or large displacement, under one numbering."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array, diags_array, kron

from multiscale.errors import CaseError
from multiscale.fe.elasticity import Elements, element_response, prepare_elements, sum_blocks
from multiscale.fe.faces import face_of, face_points
from multiscale.laws.bulk import BulkLaw
from multiscale.macro.continuum.body import Body, fixed_motion, load_vector
from multiscale.macro.continuum.contact import Contact, ContactInterface, Coupling
from multiscale.numerics.factorisation import on_diagonal


@dataclass(frozen=True)
class FiniteAssembly:
    r"""Bodies of any bulk law and the contacts between them: problem (4)-(5) of the source.

    Displacements, strains and sliding may be large. Unknown d a + i is component i of node a,
    counted over all bodies; :func:`solve_contact` solves for equilibrium.

    Parameters
    ----------
    bodies : mapping of str to Body, all of two or all of three dimensions
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
                        f"contact {name!r} names an unknown body {side[0]!r}; known bodies: "
                        f"{sorted(self.bodies)}"
                    )
                self.bodies[side[0]].check_boundary(side[1])
                touched.add(side[0])
            if contact.side1 == contact.side2:
                raise CaseError(f"both sides of contact {name!r} are the same surface")
        if not any(body.supports or body.pins for body in self.bodies.values()):
            raise CaseError("no body has a support; give supports to a body")
        for name, body in self.bodies.items():
            if body.element is not None:
                raise CaseError(
                    f"body {name!r} must not have the element {type(body.element).__name__}; "
                    f"contact at large displacement uses the corners of the mesh as nodes"
                )
            if not (body.supports or body.pins) and name not in touched:
                raise CaseError(
                    f"body {name!r} has neither a support nor a contact; give it one of these"
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
        """Unknowns without support, of bool, shape (unknowns,)."""
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
        number, interfaces, end = dict(zip(self.bodies, self.first, strict=False)), [], 0
        for name, contact in self.contacts.items():
            faces = [face_of(self.bodies[body].mesh, side) for body, side in contact.surfaces]
            nodes = [
                face.nodes + number[body]
                for face, (body, _) in zip(faces, contact.surfaces, strict=True)
            ]
            body, side = contact.side1
            area = face_points(self.bodies[body].basis, side)[1].sum(axis=1)
            free = self.free.reshape(self.start.shape)[nodes[0]]
            begin, end = end, end + nodes[0].size
            rows = slice(begin, end)
            interfaces.append(
                ContactInterface(name, contact, tuple(faces), tuple(nodes), rows, area, free)
            )
        return tuple(interfaces)

    @cached_property
    def friction(self) -> np.ndarray:
        """Coefficient of friction of every contact node."""
        return self._at_nodes([i.contact.friction_coefficient for i in self.interfaces], float)

    @cached_property
    def follows(self) -> np.ndarray:
        """Whether the partner of a contact node is a body and changes with the motion."""
        return self._at_nodes([interface.follows for interface in self.interfaces], bool)

    def _at_nodes(self, values: list[float], kind: type) -> np.ndarray:
        counts = [interface.nodes[0].size for interface in self.interfaces]
        return np.repeat(np.array(values, kind), counts)

    @cached_property
    def offset(self) -> np.ndarray:
        """Gap that is subtracted at every contact node, m, for faces that fit at the start."""
        rest = np.zeros(self.start.size)
        coupling = self.couple(rest, 0.0)
        gap = self.jump(coupling, coupling, (rest, rest), (0.0, 0.0), fitted=False)[:, 0]
        offsets = [
            interface.fitted_gap(gap[interface.rows], coupling.area[interface.rows], self.start)
            for interface in self.interfaces
        ]
        return np.concatenate([np.zeros(0), *offsets])

    @property
    def components(self) -> int:
        """Unknowns of a contact node: 1 if no contact has friction, else d."""
        return self.start.shape[1] if self.friction.any() else 1

    @cached_property
    def diagonal(self) -> np.ndarray:
        """Diagonal of the initial stiffness, shape (unknowns,), N/m, zero at supports.

        It excludes the resistance to a change of volume, so that it is the stiffness at a contact
        node also for nearly incompressible bodies.
        """
        diagonal = np.concatenate(
            [
                _stiffness(elements, body.law, shape_only=True).diagonal()
                for body, elements in zip(self.bodies.values(), self.elements, strict=True)
            ]
        )
        return np.where(self.free, diagonal, 0.0)

    @property
    def is_linear(self) -> bool:
        """Whether only the contact law is nonlinear."""
        return self.is_fixed and all(matrix is not None for matrix in self.linear)

    @property
    def is_fixed(self) -> bool:
        """Whether partners and normals of all interfaces are constant."""
        return not any(contact.finite_sliding for contact in self.contacts.values())

    def unknowns(self, body: int) -> slice:
        """Unknowns of a body."""
        d = self.start.shape[1]
        return slice(d * self.first[body], d * self.first[body + 1])

    def supported(self, time: float) -> np.ndarray:
        """Prescribed displacement of the unknowns with supports, in their order, m."""
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
            moved, linear = u[self.unknowns(k)], self.linear[k]
            if linear is not None:
                forces.append(linear @ moved)
                matrices.append(linear)
                states.append(state[k])
                continue
            force, matrix, new, ratio = element_response(
                self.elements[k], body.law, moved, state[k]
            )
            forces.append(force)
            matrices.append(matrix)
            states.append(new)
            smallest = min(smallest, ratio)
        tangent = on_diagonal(matrices)
        return np.concatenate(forces), tangent, tuple(states), smallest

    def couple(self, u: np.ndarray, time: float, old: Coupling | None = None) -> Coupling:
        """Couple all interfaces at a displacement; old couplings of small sliding are reused."""
        if old is not None and self.is_fixed:
            return old
        x, couplings = self.start + u.reshape(self.start.shape), []
        for interface in self.interfaces:
            moving = interface.contact.finite_sliding
            if old is not None and not moving:
                couplings.append(old[interface.rows])
            else:
                couplings.append(interface.couple(x if moving else self.start, time))
        return Coupling.stack(couplings, *self.start.shape)

    def operators(self, old: Coupling, now: Coupling) -> tuple[csr_array, csr_array]:
        """Weighted jump B in the local frames and its derivative, (c contact nodes, unknowns), m².

        The transpose of B times the reaction is H r. The derivative of the slip uses the partners
        of the step before; without friction there are only normal rows.
        """
        c, d = self.components, self.start.shape[1]
        n, unit = now.area.size, np.eye(d)
        i, j = np.arange(n * c).reshape(n, c), np.arange(n * d).reshape(n, d)
        turn = sum_blocks(now.frame[:, :c], i, j, (n * c, n * d))
        B = csr_array(turn @ kron(now.operator, unit, format="csr"))
        if c == 1 or not self.follows.any():
            return B, B
        slip = turn @ kron(now.slip_operator(old), unit, format="csr")
        along = np.repeat(self.follows, c) & (np.arange(n * c) % c > 0)
        return B, csr_array(B + diags_array(1.0 * along) @ (slip - B))

    def jump(
        self,
        old: Coupling,
        now: Coupling,
        motion: tuple[np.ndarray, np.ndarray],
        times: tuple[float, float],
        *,
        fitted: bool = True,
    ) -> np.ndarray:
        """Gap and slip of a step, means over the area of each contact node, (nodes, c), m.

        Couplings, motions and times are given at its start and its end.
        """
        start, d = self.start, self.start.shape[1]
        before, u = (field.reshape(-1, d) for field in motion)
        area = np.where(now.area > 0.0, now.area, 1.0)[:, None]
        distance = now.operator @ (start + u) / area
        slip = now.operator @ (u - before) / area
        # partners of the step before, (2); nodes without partner have the slip above
        partner = self.follows & (old.area > 0.0)
        if partner.any():
            turned = now.slip_operator(old) @ (start + u) / area - distance
            slip[partner] = turned[partner]
        gap = np.einsum("ai,ai->a", now.frame[:, 0], distance)
        for interface in self.interfaces:
            rows = interface.rows
            if (obstacle := interface.contact.obstacle) is not None:
                last, shift = (obstacle.moved(d, time) for time in times)
                slip[rows] += shift - last
                nodes, normal = interface.nodes[0], now.frame[rows, 0]
                gap[rows] = interface.obstacle_gap(start[nodes], u[nodes], normal, shift)
        jump = np.einsum("aki,ai->ak", now.frame, slip)
        jump[:, 0] = gap - self.offset if fitted else gap
        return np.asarray(jump[:, : self.components])


def _stiffness(elements: Elements, law: BulkLaw, *, shape_only: bool = False) -> csr_array:
    """Stiffness of an undeformed body, N/m; maybe without its resistance to a change of volume."""
    state, u = law.initial_state(elements.weight.shape), np.zeros(elements.size)
    return element_response(elements, law, u, state, shape_only=shape_only)[1]

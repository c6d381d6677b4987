r"""Semismooth Newton on displacement and contact reaction together.

A load step of (4)-(5) of the source with Coulomb friction [1]_; linear problems are condensed onto
the reactions r by the Delassus operator :math:`W = H^t K^{-1} H`:

.. math:: f_{int}(u) - H r = f, \qquad 0 \le g(u) \perp r_n \ge 0, \quad |r_t| \le \mu r_n,

.. math:: u = K^{-1}(f + H r), \qquad H^t u = q + W r.    \tag{2}

.. [1] P. Alart and A. Curnier, Comput. Methods Appl. Mech. Eng. 92 (1991) 353-375,
   doi:10.1016/0045-7825(91)90022-X.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.linalg import norm
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse import block_array, csr_array, diags_array

from multiscale.convergence import Solution, Status
from multiscale.errors import ConvergenceError, MultiscaleError
from multiscale.fe.elasticity import compliances, count_free_motions, sum_blocks
from multiscale.macro.continuum.contact import Coupling
from multiscale.macro.continuum.finite_assembly import FiniteAssembly
from multiscale.nonsmooth.friction_methods import linearise
from multiscale.numerics.factorisation import factorise
from multiscale.numerics.newton import Limits, NewtonRun

PATIENCE = 15  # iterations without a smaller residual after which a step fails
CYCLE = 4  # iterations without a smaller residual after which steps are halved to leave a cycle

ROUND_OFF, UNSURE = 8.0 * np.finfo(float).eps, 1e-6
"""Rounding of the residual force relative to the terms of K u, which matters for stiff bodies; and
the largest residual ascribed to it: a body that moves away must not count as in equilibrium."""

SMALLEST_RATIO = 0.05  # volume ratio of an element below which a Newton step is shortened
LANDINGS = 5  # limit in a step of closures of the nearest surface for a body without support
HALVINGS = 8  # limit of halvings of a Newton step
RELAXATION = 0.3  # stiffness of the contact law relative to the bodies: with 1, friction cycles


@dataclass(frozen=True)
class ContactEquilibrium:
    """A state of the whole problem."""

    time: float
    displacement: np.ndarray  # shape (unknowns,), m
    reaction: np.ndarray  # shape (contact nodes, c), Pa
    state: tuple[np.ndarray, ...]  # internal variables of the bodies
    coupling: Coupling  # of all interfaces
    jump: np.ndarray  # gap and slip of the step, shape (contact nodes, c), m
    unbalance: np.ndarray  # internal less external and contact forces, N: support forces


class LocalLaw(NamedTuple):
    """Residual of the contact law, and its derivatives of shape (nodes, c, c)."""

    residual: np.ndarray  # shape (nodes, c), Pa
    by_reaction: np.ndarray  # dimensionless
    by_jump: np.ndarray  # Pa/m; rows are zero where the node is open


@dataclass(frozen=True)
class _Trial:
    """A state with its residual, and the tangents of the next Newton step."""

    end: ContactEquilibrium
    tangent: csr_array
    operator: csr_array
    jump_tangent: csr_array
    rho: np.ndarray
    law: LocalLaw
    residual: float
    floor: float
    usable: bool


def linearise_contact(
    reaction: np.ndarray,
    jump: np.ndarray,
    friction: np.ndarray,
    stiffness: np.ndarray,
    transmits: np.ndarray,
) -> LocalLaw:
    """Evaluate the contact law at nodes and a member of its generalised derivative."""
    c = reaction.shape[1]
    lost = ~transmits
    lost[:, 1:] |= lost[:, :1] | (friction == 0.0)[:, None]
    space = np.zeros((2, len(reaction), 3))
    space[:, :, :c] = np.where(lost, 0.0, [stiffness[:, None] * jump, reaction])
    # with y = r - rho (g, s) and the ball of radius b = mu max(0, y_n)
    #     R_n = r_n - max(0, y_n),  R_t = r_t - P_b(y_t),  (1)
    # zero if and only if (5) of the source holds with Coulomb's law
    residual, by_jump, by_reaction = linearise(*space, friction)  # (1)
    return LocalLaw(
        np.where(lost, reaction, residual[:, :c]),
        np.where(lost[:, :, None], np.eye(c), by_reaction[:, :c, :c]),
        np.where(lost[:, :, None], 0.0, stiffness[:, None, None] * by_jump[:, :c, :c]),
    )


def rest(assembly: FiniteAssembly) -> ContactEquilibrium:
    """State before the first load step."""
    u = np.zeros(assembly.start.size)
    coupling = assembly.couple(u, 0.0)
    jump = assembly.jump(coupling, coupling, (u, u), (0.0, 0.0))
    return ContactEquilibrium(
        0.0, u, np.zeros_like(jump), assembly.initial_state(), coupling, jump, u
    )


def newton_step(
    assembly: FiniteAssembly, before: ContactEquilibrium, time: float, limits: Limits
) -> tuple[Solution, ContactEquilibrium]:
    """Solve a load step: semismooth Newton on displacement and reaction."""
    problem = _Step(assembly, before, time, assembly.load(time), assembly.supported(time))
    trial = problem.evaluate(before.displacement, before.reaction, before.coupling)
    landings = LANDINGS
    run = NewtonRun(limits, PATIENCE)

    while run.goes_on(trial.residual, trial.floor):
        du, dr, landed = problem.direction(trial, may_land=landings > 0)
        landings -= landed
        trial = problem.advance(trial, du, dr, 0.5 if run.since_best > CYCLE else 1.0)

    return run.solution(trial.end.displacement), trial.end


@dataclass(frozen=True)
class _Step:
    assembly: FiniteAssembly
    before: ContactEquilibrium
    time: float
    load: np.ndarray
    motion: np.ndarray

    def evaluate(self, u: np.ndarray, reaction: np.ndarray, old: Coupling) -> _Trial:
        """Residual and tangents at a displacement and a reaction."""
        assembly, before = self.assembly, self.before
        coupling = assembly.couple(u, self.time, old)
        B, jump_tangent = assembly.operators(before.coupling, coupling)
        force, tangent, state, smallest = assembly.internal(u, before.state)
        motion, times = (before.displacement, u), (before.time, self.time)
        jump = assembly.jump(before.coupling, coupling, motion, times)
        rho = _contact_stiffness(assembly, B, coupling.area)
        transmits = coupling.transmits[:, : assembly.components]
        law = linearise_contact(reaction, jump, assembly.friction, rho, transmits)
        contact = B.T @ reaction.ravel()  # H r
        unbalance = force - contact - self.load  # (4)

        # residual of equilibrium, contact law and supports, relative to the largest force
        free = assembly.free
        scale = max(float(norm(f)) for f in (self.load, contact, (force - contact)[~free]))
        wrong = law.residual * coupling.area[:, None]
        late = tangent.diagonal()[~free] * (self.motion - u[~free])
        error = float(np.hypot(norm(unbalance[free]), np.hypot(norm(wrong), norm(late))))
        residual = error / scale if scale > 0.0 else float(error > 0.0)
        size = float(norm((abs(tangent) @ np.abs(u))[free]))
        floor = min(UNSURE, ROUND_OFF * size / scale) if scale > 0.0 else 0.0
        end = ContactEquilibrium(self.time, u, reaction, state, coupling, jump, unbalance)
        usable = smallest > SMALLEST_RATIO and bool(np.isfinite(residual))
        return _Trial(end, tangent, B, jump_tangent, rho, law, residual, floor, usable)

    def direction(self, trial: _Trial, *, may_land: bool) -> tuple[np.ndarray, np.ndarray, bool]:
        """Newton step (m, Pa), and whether a contact was closed for a body without support."""
        try:
            return *self._direction(trial, trial.law), False
        except MultiscaleError as error:
            closer = self._close_nearest(trial) if may_land else None
            if closer is None:
                raise self._name_free_bodies(error) from error
        try:
            return *self._direction(trial, closer), True
        except MultiscaleError as error:
            raise self._name_free_bodies(error) from error

    def advance(self, trial: _Trial, du: np.ndarray, dr: np.ndarray, length: float) -> _Trial:
        """Move by at most a length, halved until no element is inverted."""
        for _ in range(HALVINGS):
            new = self.evaluate(
                trial.end.displacement + length * du,
                trial.end.reaction + length * dr,
                trial.end.coupling,
            )
            if new.usable:
                break
            length *= 0.5
        return new

    def _direction(self, trial: _Trial, law: LocalLaw) -> tuple[np.ndarray, np.ndarray]:
        """Solve the linearised problem without its open components."""
        # supports jump to their prescribed displacement
        assembly, B = self.assembly, trial.operator
        free = assembly.free
        du = np.zeros(free.size)
        du[~free] = self.motion - trial.end.displacement[~free]

        # reactions of open components become zero
        live = np.any(law.by_jump != 0.0, axis=2).ravel()
        dr = np.where(live, 0.0, -law.residual.ravel())
        # row of the law times the area, reaction in units of the contact stiffness: all N/m
        rho = np.repeat(trial.rho, assembly.components)
        area = np.repeat(trial.end.coupling.area, assembly.components)
        by_jump = _block_diagonal(law.by_jump)[live] @ trial.jump_tangent
        by_reaction = diags_array(area[live]) @ _block_diagonal(law.by_reaction)[live]
        rhs = np.concatenate(
            [
                (-trial.end.unbalance - trial.tangent @ du + B.T @ dr)[free],
                -area[live] * law.residual.ravel()[live] - by_jump @ du - by_reaction @ dr,
            ]
        )
        K = trial.tangent[free][:, free]
        matrix = block_array(
            [
                [K, -(B[live][:, free]).T @ diags_array(rho[live])],
                [by_jump[:, free], by_reaction[:, live] @ diags_array(rho[live])],
            ],
            format="csr",
        )
        # equilibrate, factorise, scale back
        scale = np.concatenate([np.abs(K.diagonal()), area[live] * rho[live]])
        scale = 1.0 / np.sqrt(np.where(scale > 0.0, scale, 1.0))
        matrix = csr_array(diags_array(scale) @ matrix @ diags_array(scale))
        solution = scale * factorise(matrix, name="the tangent stiffness")(scale * rhs)
        du[free] = solution[: K.shape[0]]
        dr[live] = rho[live] * solution[K.shape[0] :]
        return du, dr.reshape(-1, assembly.components)

    def _close_nearest(self, trial: _Trial) -> LocalLaw | None:
        """Contact law with the nearest nodes of every open interface closed."""
        law, jump = trial.law, trial.end.jump
        closed = np.zeros(len(jump), dtype=bool)
        coupling = trial.end.coupling
        for interface in self.assembly.interfaces:
            rows = interface.rows
            possible = coupling.transmits[rows, 0]
            if possible.any() and not np.any(law.by_jump[rows, 0, 0]):
                gap = np.where(possible, jump[rows, 0], np.inf)
                closed[rows] = gap <= gap.min() + 1e-6 * np.sqrt(coupling.area[rows].max())
        if not closed.any():
            return None
        rho = trial.rho
        residual, by_reaction, by_jump = (np.array(field) for field in law)
        residual[closed] = trial.end.reaction[closed]
        residual[closed, 0] = rho[closed] * jump[closed, 0]
        by_reaction[closed, 0, 0] = 0.0
        by_jump[closed, 0, 0] = rho[closed]
        return LocalLaw(residual, by_reaction, by_jump)

    def _name_free_bodies(self, error: MultiscaleError) -> ConvergenceError:
        names = list(self.assembly.bodies)
        assembly, first = self.assembly, self.assembly.first
        flat = assembly.start.shape[1] == 2  # in a plane, nodes are fixed across it
        x = np.pad(assembly.start, ((0, 0), (0, int(flat))))
        fixed = np.pad(~assembly.free.reshape(assembly.start.shape), ((0, 0), (0, int(flat))))
        fixed[:, 2] |= flat
        free = [
            name
            for name, nodes in zip(names, map(slice, first[:-1], first[1:]), strict=True)
            if count_free_motions(x[nodes], fixed[nodes])
        ]
        if not free:
            return ConvergenceError(
                f"the tangent stiffness is singular at time {self.time:g}: {error}"
            )
        for name in free:
            if slides := self._slides(name):
                return ConvergenceError(slides)
        return ConvergenceError(
            f"{' and '.join(repr(name) for name in free)} can move without force at time "
            f"{self.time:g}: supports do not prevent it and no contact closes; "
            f"add supports or prescribe displacements"
        )

    def _slides(self, name: str) -> str | None:
        """Explain a load on a body above the friction before this step, if it is above."""
        assembly, before = self.assembly, self.before
        d, body = assembly.start.shape[1], list(assembly.bodies).index(name)
        low, high = assembly.first[body : body + 2]
        carried, normal = 0.0, np.zeros(d)
        for interface in assembly.interfaces:
            rows = interface.rows
            if any(low <= nodes[0] < high for nodes in interface.nodes):
                force = before.reaction[rows, 0] * before.coupling.area[rows]
                carried += float(assembly.friction[rows] @ force)
                normal += force @ before.coupling.frame[rows, 0]
        load = self.load[assembly.unknowns(body)].reshape(-1, d).sum(axis=0)
        normal /= norm(normal) or 1.0
        along = float(norm(load - (load @ normal) * normal))
        if not 0.0 < carried < along:
            return None
        unit = "N" if d == 3 else "N/m"
        return (
            f"{name!r} slides away at time {self.time:g}: its load along its contacts is "
            f"{along:.4g} {unit}, their friction carries about {carried:.4g} {unit}; reduce the "
            f"load, increase the pressure, or prescribe the displacement"
        )


def _contact_stiffness(assembly: FiniteAssembly, B: csr_array, area: np.ndarray) -> np.ndarray:
    """Stiffness rho of the contact law, Pa/m: of the order of the stiffness at a node."""
    diagonal = assembly.diagonal
    compliance = np.where(diagonal > 0.0, 1.0 / np.where(diagonal > 0.0, diagonal, 1.0), 0.0)
    normal = B[:: assembly.components]
    softness = normal.power(2) @ compliance  # of a unit reaction, times area: m / (Pa/m2)
    typical = area / np.where(softness > 0.0, softness, 1.0)
    usual = float(np.median(typical[softness > 0.0])) if np.any(softness > 0.0) else 1.0
    return np.asarray(RELAXATION * np.where(softness > 0.0, typical, usual))


def _block_diagonal(blocks: np.ndarray) -> csr_array:
    n, c, _ = blocks.shape
    place = np.arange(n * c).reshape(n, c)
    return sum_blocks(blocks, place, place, (n * c, n * c))


@dataclass(frozen=True)
class CondensedContact:
    """A linear contact problem in its reactions."""

    assembly: FiniteAssembly
    coupling: Coupling
    operator: csr_array  # weighted jump, shape (contact unknowns, unknowns), m²
    stiffness: csr_array  # of all bodies, N/m
    solve: Callable[[np.ndarray], np.ndarray]  # with the stiffness of the free unknowns
    delassus: np.ndarray  # mean jump of a node, m, for a unit reaction, Pa
    rho: np.ndarray  # stiffness of the contact law, shape (contact nodes,), Pa/m

    def step(
        self, before: ContactEquilibrium, time: float, limits: Limits
    ) -> tuple[Solution, ContactEquilibrium]:
        """Solve a load step; arguments and result as in ``newton_step``."""
        load = self.assembly.load(time)
        motion = self.assembly.supported(time)
        # gap and slip without reactions, and the size of the forces
        without = self._displacement(load, motion)
        q = self._jump(before, without, time)
        support = float(norm((self.stiffness @ without)[~self.assembly.free]))
        scale = max(float(norm(load)), support)

        # Newton on the reactions of the step before
        r = np.array(before.reaction)
        law, residual = self._linearise(r, q, scale)
        run = NewtonRun(limits, PATIENCE)
        while run.goes_on(residual):
            r = r + (0.5 if run.since_best > CYCLE else 1.0) * self._direction(law)
            law, residual = self._linearise(r, q, scale)

        # displacement and its equilibrium
        force = load + self.operator.T @ r.ravel()
        u = self._displacement(force, motion)
        unbalance = self.stiffness @ u - force
        if run.converged and not self._balanced(u, force, unbalance, limits.tolerance):
            run.stop(Status.STALLED)
        jump = self._jump(before, u, time)
        end = ContactEquilibrium(time, u, r, before.state, self.coupling, jump, unbalance)
        return run.solution(u), end

    def _linearise(self, r: np.ndarray, q: np.ndarray, scale: float) -> tuple[LocalLaw, float]:
        """Contact law at a reaction, and its error relative to the forces."""
        transmits = self.coupling.transmits[:, : self.assembly.components]
        jump = q + (self.delassus @ r.ravel()).reshape(r.shape)  # (2)
        law = linearise_contact(r, jump, self.assembly.friction, self.rho, transmits)
        size = max(scale, float(norm(self.operator.T @ r.ravel())))
        error = float(norm(law.residual * self.coupling.area[:, None]))
        return law, error / size if size > 0.0 else float(error > 0.0)

    def _balanced(
        self, u: np.ndarray, force: np.ndarray, unbalance: np.ndarray, tolerance: float
    ) -> bool:
        """Whether the displacement is in equilibrium, to the tolerance or to round-off."""
        free = self.assembly.free
        terms = float(norm((abs(self.stiffness) @ np.abs(u))[free]))
        scale = max(float(norm(force)), float(norm(unbalance[~free])))
        return float(norm(unbalance[free])) <= max(tolerance * scale, ROUND_OFF * terms)

    def _displacement(self, force: np.ndarray, motion: np.ndarray) -> np.ndarray:
        u, free = np.zeros(force.size), self.assembly.free
        u[~free] = motion
        u[free] = self.solve((force - self.stiffness @ u)[free])
        return u

    def _jump(self, before: ContactEquilibrium, u: np.ndarray, time: float) -> np.ndarray:
        motions = (before.displacement, u)
        coupling, times = self.coupling, (before.time, time)
        return self.assembly.jump(coupling, coupling, motions, times)

    def _direction(self, law: LocalLaw) -> np.ndarray:
        """Newton step of the reactions, Pa; reactions of open components become zero."""
        live = np.any(law.by_jump != 0.0, axis=2).ravel()
        residual = law.residual.ravel()
        dr = np.where(live, 0.0, -residual)
        if live.any():
            by_jump, by_reaction = (
                _block_diagonal(blocks)[live] for blocks in (law.by_jump, law.by_reaction)
            )
            matrix = by_jump @ self.delassus[:, live] + by_reaction[:, live].toarray()
            right = residual[live] + by_jump @ (self.delassus @ dr) + by_reaction @ dr
            dr[live] = -lu_solve(lu_factor(matrix), right)
        return dr.reshape(law.residual.shape)


def condense_contact(
    assembly: FiniteAssembly, start: ContactEquilibrium
) -> CondensedContact | None:
    """Factorise the bodies and compute W; None if a body is supported only by contacts."""
    coupling = start.coupling
    operator = assembly.operators(coupling, coupling)[0]
    stiffness = assembly.internal(start.displacement, start.state)[1]
    free = assembly.free
    try:
        solve = factorise(csr_array(stiffness[free][:, free]), name="the stiffness of the bodies")
    except MultiscaleError:
        return None
    B = csr_array(operator[:, free])
    area = np.repeat(np.where(coupling.area > 0.0, coupling.area, 1.0), assembly.components)
    W = compliances(solve, B)[0] / area[:, None]
    soft = W.diagonal()[:: assembly.components]
    usual = float(np.median(soft[soft > 0.0])) if np.any(soft > 0.0) else 1.0
    rho = RELAXATION / np.where(soft > 0.0, soft, usual)
    return CondensedContact(assembly, coupling, operator, stiffness, solve, W, rho)

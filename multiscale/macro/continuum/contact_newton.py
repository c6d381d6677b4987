r"""Semismooth Newton on displacement and contact reaction together.

One load step of the source's problem (4)-(5) with Coulomb friction,

.. math:: f_{int}(u) - H r = f, \qquad 0 \le g(u) \perp r_n \ge 0, \quad |r_t| \le \mu r_n,

for any bulk law and either kind of sliding: material, geometry, contact set and friction are
updated in one loop, and the displacement is kept as the main unknown.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from scipy.sparse import block_array, csr_array, diags_array

from multiscale.convergence import Solution
from multiscale.errors import ConvergenceError, MultiscaleError
from multiscale.fe.elements import sum_blocks
from multiscale.fe.rigid_motion import count_free_motions
from multiscale.macro.continuum.finite_assembly import FiniteAssembly, JoinedContacts
from multiscale.macro.continuum.interface import Coupling
from multiscale.macro.continuum.nodal_coulomb import LocalLaw, linearise
from multiscale.numerics.factorisation import factorise
from multiscale.numerics.newton import Limits, NewtonRun

__all__ = ["Equilibrium", "block_diagonal", "contact_stiffness", "newton_step", "rest"]

PATIENCE = 15
"""Iterations without a smaller residual after which a step gives up."""

CYCLE = 4
"""Iterations without a smaller residual after which steps are halved to leave a cycle."""

ROUND_OFF, UNSURE = 8.0 * np.finfo(float).eps, 1e-6
"""Unbalance, relative to the terms of K u, that rounding leaves: it counts with stiff bodies; and
the largest residual that it excuses, or a body that runs away would count as in balance."""

SMALLEST_RATIO = 0.05
"""Volume ratio of an element below which a Newton step is shortened."""

LANDINGS = 5
"""How often in a step a loose body is put down on what lies nearest."""

HALVINGS = 8
"""How often a Newton step may be halved."""

RELAXATION = 0.3
"""Stiffness of the contact law relative to the bodies' own: 1 makes friction cycle."""


@dataclass(frozen=True)
class Equilibrium:
    """A state of the whole problem.

    Attributes
    ----------
    time : float, of the load step
    displacement : ndarray, shape (unknowns,), m
    reaction : ndarray, shape (contact nodes, c), Pa
    state : tuple of ndarray, internal variables of the bodies
    couplings : tuple of Coupling, of the interfaces
    jump : ndarray, shape (contact nodes, c), gap and slip of the step, m
    unbalance : ndarray, shape (unknowns,)
        Internal less external and contact forces, N: what the supports carry.
    """

    time: float
    displacement: np.ndarray
    reaction: np.ndarray
    state: tuple[np.ndarray, ...]
    couplings: tuple[Coupling, ...]
    jump: np.ndarray
    unbalance: np.ndarray


@dataclass(frozen=True)
class _Trial:
    """A state, its residual and what the next Newton step needs."""

    end: Equilibrium
    tangent: csr_array
    joined: JoinedContacts
    rho: np.ndarray
    law: LocalLaw
    residual: float
    floor: float
    usable: bool


def rest(assembly: FiniteAssembly) -> Equilibrium:
    """State before the first load step."""
    u = np.zeros(assembly.start.size)
    couplings = assembly.couplings(u, 0.0, None)
    jump = assembly.jump(couplings, couplings, (u, u), (0.0, 0.0))
    return Equilibrium(0.0, u, np.zeros_like(jump), assembly.initial_state(), couplings, jump, u)


def newton_step(
    assembly: FiniteAssembly, before: Equilibrium, time: float, limits: Limits
) -> tuple[Solution, Equilibrium]:
    """Solve one load step."""
    problem = _Step(assembly, before, time, assembly.load(time), assembly.supported(time))
    trial = problem.evaluate(before.displacement, before.reaction, before.couplings)
    landings = LANDINGS
    run = NewtonRun(limits, PATIENCE)

    while run.goes_on(trial.residual, trial.floor):
        du, dr, landed = problem.direction(trial, may_land=landings > 0)
        landings -= landed
        trial = problem.advance(trial, du, dr, 0.5 if run.since_best > CYCLE else 1.0)

    return run.solution(trial.end.displacement), trial.end


@dataclass(frozen=True)
class _Step:
    """One load step of a problem."""

    assembly: FiniteAssembly
    before: Equilibrium
    time: float
    load: np.ndarray
    motion: np.ndarray

    def evaluate(self, u: np.ndarray, reaction: np.ndarray, old: tuple[Coupling, ...]) -> _Trial:
        """Residual and tangents at a displacement and a reaction."""
        assembly, before = self.assembly, self.before
        couplings = assembly.couplings(u, self.time, old)
        joined = assembly.join(before.couplings, couplings)
        force, tangent, state, smallest = assembly.internal(u, before.state)
        motion, times = (before.displacement, u), (before.time, self.time)
        jump = assembly.jump(before.couplings, couplings, motion, times)
        rho = contact_stiffness(assembly, joined)
        law = linearise(reaction, jump, assembly.friction, rho, joined.kept)
        contact = joined.operator.T @ reaction.ravel()  # H r
        unbalance = force - contact - self.load  # (4)

        free = assembly.free
        scale = max(float(norm(f)) for f in (self.load, contact, (force - contact)[~free]))
        wrong = law.residual * joined.area[:, None]
        late = tangent.diagonal()[~free] * (self.motion - u[~free])
        error = float(np.hypot(norm(unbalance[free]), np.hypot(norm(wrong), norm(late))))
        residual = error / scale if scale > 0.0 else float(error > 0.0)
        size = float(norm((abs(tangent) @ np.abs(u))[free]))
        floor = min(UNSURE, ROUND_OFF * size / scale) if scale > 0.0 else 0.0
        end = Equilibrium(self.time, u, reaction, state, couplings, jump, unbalance)
        usable = smallest > SMALLEST_RATIO and bool(np.isfinite(residual))
        return _Trial(end, tangent, joined, rho, law, residual, floor, usable)

    def direction(self, trial: _Trial, *, may_land: bool) -> tuple[np.ndarray, np.ndarray, bool]:
        """Newton step (m, Pa), and whether a loose body was put down for it."""
        try:
            return *self._direction(trial, trial.law), False
        except MultiscaleError as error:
            closer = self._close_nearest(trial) if may_land else None
            if closer is None:
                raise self._loose(error) from error
        try:
            return *self._direction(trial, closer), True
        except MultiscaleError as error:
            raise self._loose(error) from error

    def advance(self, trial: _Trial, du: np.ndarray, dr: np.ndarray, length: float) -> _Trial:
        """Take a step of at most a length, so short that no element is turned inside out."""
        for _ in range(HALVINGS):
            new = self.evaluate(
                trial.end.displacement + length * du,
                trial.end.reaction + length * dr,
                trial.end.couplings,
            )
            if new.usable:
                break
            length *= 0.5
        return new

    def _direction(self, trial: _Trial, law: LocalLaw) -> tuple[np.ndarray, np.ndarray]:
        """Solve the linearised problem; open components leave it at once."""
        assembly, joined = self.assembly, trial.joined
        free = assembly.free
        du = np.zeros(free.size)
        du[~free] = self.motion - trial.end.displacement[~free]

        live = np.any(law.by_jump != 0.0, axis=2).ravel()
        dr = np.where(live, 0.0, -law.residual.ravel())
        B = joined.operator
        # row of the law times the area, reaction in units of the contact stiffness: all N/m
        rho = np.repeat(trial.rho, assembly.components)
        area = np.repeat(joined.area, assembly.components)
        by_jump = block_diagonal(law.by_jump)[live] @ joined.tangent
        by_reaction = diags_array(area[live]) @ block_diagonal(law.by_reaction)[live]
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
        scale = np.concatenate([np.abs(K.diagonal()), area[live] * rho[live]])
        scale = 1.0 / np.sqrt(np.where(scale > 0.0, scale, 1.0))
        matrix = csr_array(diags_array(scale) @ matrix @ diags_array(scale))
        solution = scale * factorise(matrix, name="the tangent stiffness")(scale * rhs)
        du[free] = solution[: K.shape[0]]
        dr[live] = rho[live] * solution[K.shape[0] :]
        return du, dr.reshape(-1, assembly.components)

    def _close_nearest(self, trial: _Trial) -> LocalLaw | None:
        """Contact law with the nearest nodes of every open interface closed: a loose body lands."""
        law, jump = trial.law, trial.end.jump
        closed = np.zeros(len(jump), dtype=bool)
        for part, coupling in zip(self.assembly.contact_nodes, trial.end.couplings, strict=True):
            possible = trial.joined.kept[part, 0]
            if possible.any() and not np.any(law.by_jump[part, 0, 0]):
                gap = np.where(possible, jump[part, 0], np.inf)
                closed[part] = gap <= gap.min() + 1e-6 * np.sqrt(coupling.area.max())
        if not closed.any():
            return None
        rho = trial.rho
        residual, by_reaction, by_jump = (
            np.array(part) for part in (law.residual, law.by_reaction, law.by_jump)
        )
        residual[closed] = trial.end.reaction[closed]
        residual[closed, 0] = rho[closed] * jump[closed, 0]
        by_reaction[closed, 0, 0] = 0.0
        by_jump[closed, 0, 0] = rho[closed]
        return LocalLaw(residual, by_reaction, by_jump)

    def _loose(self, error: MultiscaleError) -> ConvergenceError:
        """Name the bodies that their supports alone do not hold."""
        names = list(self.assembly.bodies)
        assembly, first = self.assembly, self.assembly.first
        flat = assembly.start.shape[1] == 2  # in a plane, as nodes held across it
        x = np.pad(assembly.start, ((0, 0), (0, int(flat))))
        held = np.pad(~assembly.free.reshape(assembly.start.shape), ((0, 0), (0, int(flat))))
        held[:, 2] |= flat
        loose = [
            name
            for name, part in zip(names, map(slice, first[:-1], first[1:]), strict=True)
            if count_free_motions(x[part], held[part])
        ]
        if not loose:
            return ConvergenceError(
                f"the tangent stiffness is singular at time {self.time:g}: {error}"
            )
        for name in loose:
            if slides := self._slides(name):
                return ConvergenceError(slides)
        return ConvergenceError(
            f"{' and '.join(repr(name) for name in loose)} can move without force at time "
            f"{self.time:g}: the supports do not hold it and no contact closes; "
            f"add supports or move it by prescribed displacements"
        )

    def _slides(self, name: str) -> str | None:
        """Say what the friction before this step carries of the load on a body, if too little."""
        assembly, before = self.assembly, self.before
        d, body = assembly.start.shape[1], list(assembly.bodies).index(name)
        low, high = assembly.first[body : body + 2]
        carried, normal = 0.0, np.zeros(d)
        parts = zip(assembly.interfaces, assembly.contact_nodes, before.couplings, strict=True)
        for interface, part, coupling in parts:
            if any(low <= nodes[0] < high for nodes in interface.nodes):
                force = before.reaction[part, 0] * coupling.area
                carried += float(assembly.friction[part] @ force)
                normal += force @ coupling.frame[:, 0]
        load = self.load[assembly.unknowns(body)].reshape(-1, d).sum(axis=0)
        normal /= norm(normal) or 1.0
        along = float(norm(load - (load @ normal) * normal))
        if not 0.0 < carried < along:
            return None
        unit = "N" if d == 3 else "N/m"
        return (
            f"{name!r} slides away at time {self.time:g}: of its load of {along:.4g} {unit} along "
            f"its contacts their friction carries about {carried:.4g} {unit}; lower the load, "
            f"press harder, or prescribe the displacement"
        )


def contact_stiffness(assembly: FiniteAssembly, joined: JoinedContacts) -> np.ndarray:
    """Stiffness rho of the contact law, Pa/m: of the order of the stiffness that a node feels."""
    diagonal = assembly.diagonal
    compliance = np.where(diagonal > 0.0, 1.0 / np.where(diagonal > 0.0, diagonal, 1.0), 0.0)
    normal = joined.operator[:: assembly.components]
    softness = normal.power(2) @ compliance  # of a unit reaction, times area: m / (Pa/m2)
    typical = joined.area / np.where(softness > 0.0, softness, 1.0)
    usual = float(np.median(typical[softness > 0.0])) if np.any(softness > 0.0) else 1.0
    return np.asarray(RELAXATION * np.where(softness > 0.0, typical, usual))


def block_diagonal(blocks: np.ndarray) -> csr_array:
    """Sparse matrix of small square blocks, shape (n, c, c)."""
    n, c, _ = blocks.shape
    place = np.arange(n * c).reshape(n, c)
    return sum_blocks(blocks, place, place, (n * c, n * c))

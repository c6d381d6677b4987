r"""Micro-macro LATIN: a local stage for links and laws, a linear stage for the structure."""

from collections import defaultdict
from itertools import count
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.macro.substructures.capacity import Slide, find_slide
from multiscale.macro.substructures.coarse import coarse_basis, prepare_coarse
from multiscale.macro.substructures.directions import (
    body_stiffness,
    interface_stiffness,
    joint_directions,
    law_stiffness,
    schur_complements,
    side_stiffness,
)
from multiscale.macro.substructures.problem import CutProblem
from multiscale.macro.substructures.stack import (
    Alone,
    Factors,
    ProcessGroup,
    lay_out_sides,
    share,
    stack_parts,
)
from multiscale.macro.substructures.stepping import JointState

__all__ = ["Latin", "LatinIterate"]

FIRST, TAUT, SLACK = 1.0, 10.0, 0.05
"""Stiffness of the search direction of a link over that of the link: at first, and by status."""

MAJOR_INTERVAL, MINOR_INTERVAL = 8, 4
"""Iterations until the status is checked again, after it changed in many links or in few."""

CHANGE = 2.0
"""Factor by which the direction of a point of a joint must change to be taken anew."""

MINOR_CHANGE, SOFTER, SOFTEST = 3e-2, 0.3, 3e-3
"""If less than this part of the links changes its status, slack ones get a direction softer by
this factor, down to this: the directions tend to the tangent, which near mechanisms need."""

LAST = 1e-3
"""If less than this part changes, the softest direction is taken at once, and from then on the
stiffness of interfaces and the accelerating iterates are kept."""


REST = 1e-2
"""Forces below this part of the largest of the steps before are judged against that part: a step
that takes all load away has none."""


ROUNDING, UNSURE = 1e3 * np.finfo(float).eps, 1e-6
"""Change of the forces that rounding of the motion makes, relative to the forces in the norm of
the diagonal of the stiffness, measured on blocks on joints a million times softer; and the largest
that is allowed for: without a limit, a body that runs away would count as in balance."""


class LatinIterate(NamedTuple):
    """State after the linear stage.

    Attributes
    ----------
    u : ndarray, shape (n,), displacement of the substructures of this process, m
    tension : ndarray, shape (rows,), forces of their links, N
    force, push : ndarray, shape (m,), on all sides of all interfaces, and :math:`k_0 T u` there, N
    """

    u: np.ndarray
    tension: np.ndarray
    force: np.ndarray
    push: np.ndarray


class Latin:
    r"""A problem prepared for LATIN iterations.

    The unknown of the iteration is :math:`x = (z, r)` with :math:`z = \tau - l \lambda` in the
    links and :math:`r = k_0 T u - F` on the sides: the part of a state that one stage hands to
    the other. The *local stage* is slack and interfaces, the *linear stage* the equilibrium
    of every substructure and, through the coarse problem, the equilibrium of the coarse
    forces.
    """

    def __init__(
        self,
        problem: CutProblem,
        *,
        coarse: bool = True,
        updated: bool = True,
        team: ProcessGroup | None = None,
    ) -> None:
        self.problem, self.team = problem, team or Alone()
        self.coarse_wanted, self.updated = coarse, updated
        self.parts = share(len(problem.substructures), self.team)
        self.sides, self.stack = lay_out_sides(problem), stack_parts(problem, self.parts)
        self.basis = coarse_basis(problem)
        first = self.sides.start[self.parts.start]
        self.rows = slice(first, first + self.stack.trace.shape[0])
        self.factors = Factors(), Factors(), Factors()
        links = self.stack.links
        self.diagonal = self.stack.stiffness.diagonal()
        self.pull, self.lift = csr_array(links.operator.T), csr_array(self.stack.trace.T)
        first_joint = len(problem.interfaces) - len(problem.joints)
        self.joints = list(zip(count(first_joint), problem.joints, problem.points, strict=False))
        self.law, self.weight = problem.law, problem.weight
        self.state = JointState.at_rest(problem)
        self.bodies = {index: body_stiffness(problem, face) for index, face, _ in self.joints}
        self.joint_k = self.directions(np.full((3, self.weight.size), np.inf))
        self.perfect_k: dict[int, np.ndarray] = {}
        self.look_behind(np.ones(links.stiffness.size))
        self.direct(np.where(self.stack.one_sided, FIRST, 1.0))
        self.status: np.ndarray | None = None
        self.slack_direction = SLACK
        self.z, self.r = links.prestress.copy(), np.zeros(self.sides.m)
        self.largest = 0.0

    def resume(self, state: JointState) -> None:
        """Start from another state, which has no forces on perfect interfaces."""
        self.state, self.largest = state, 0.0
        local = [state.unknowns[self.problem.substructures[part].unknown] for part in self.parts]
        moved = self.stack.trace @ np.concatenate(local)
        self.r = self.k0.matrix @ self.team.concatenate(moved)
        first, second = self.sides.joints
        self.r[first] -= self.weight * state.traction
        self.r[second] += self.weight * state.traction

    @property
    def n_coarse(self) -> int:
        """Size of the coarse problem."""
        return int(self.basis.shape[1])

    def look_behind(self, carries: np.ndarray) -> None:
        """Find the stiffness behind perfect interfaces, given the share that links carry."""
        ground = np.zeros(self.sides.m)
        for index, sides in self.joint_k.items():
            for place, k in zip(self.sides.place[index], sides, strict=True):
                ground[place] = k
        schur = schur_complements(
            self.stack, carries, diags_array(ground[self.rows]), self.factors[0]
        )
        self.perfect_k = interface_stiffness(
            self.problem, schur, self.parts, self.team, self.perfect_k
        )

    def direct(self, relative: np.ndarray) -> None:
        """Set the search directions and factorise what follows from them."""
        links = self.stack.links
        self.across = relative * links.stiffness  # l
        self.k0 = side_stiffness(self.problem, self.sides, self.perfect_k, self.joint_k)
        self.compliance = 1.0 / self.k0.matrix.diagonal()[self.sides.joints]  # of sides of joints
        k, across = links.stiffness, self.across
        effective = np.where(self.stack.one_sided, k * across / (k + across), k)
        sides = self.k0.matrix[self.rows][:, self.rows]
        self.solve = self.factors[1](self.stack.matrix(effective, sides))
        self.coarse = None
        if self.coarse_wanted and self.n_coarse:
            self.coarse = prepare_coarse(
                self.basis,
                self.k0.matrix,
                self.stack,
                self.sides,
                self.parts,
                self.solve,
                self.factors[2],
                self.team,
            )

    def iterate(self, load: np.ndarray) -> tuple[np.ndarray, np.ndarray, LatinIterate]:
        """Run the local and the linear stage from z and r."""
        links, k, across = self.stack.links, self.stack.links.stiffness, self.across
        one_sided = self.stack.one_sided
        # local stage: tau + l lambda on the other side of the projection; eq (15)
        a = 2.0 * np.clip(self.z, links.lower, links.upper) - self.z
        g = self.local_sides(self.r)

        # linear stage
        start = np.where(
            one_sided, (k * a + across * links.prestress) / (k + across), links.prestress
        )
        b = load - self.pull @ start + self.lift @ g[self.rows]
        u = self.solve(b)
        moved = self.team.concatenate(self.stack.trace @ u)
        if self.coarse is not None:
            w = self.coarse.solve(-(self.coarse.basis.T @ (g - self.k0.matrix @ moved)))
            u = u + self.coarse.respond(w)
            moved = self.team.concatenate(self.stack.trace @ u)
            g = g + self.coarse.push @ w
        e = links.operator @ u
        slack = np.where(one_sided, (a - links.prestress - k * e) / (k + across), 0.0)
        tension = links.prestress + k * (e + slack)
        push = self.k0.matrix @ moved
        force = g - push
        return (
            np.where(one_sided, tension - across * slack, tension),
            push - force,
            LatinIterate(u, tension, force, push),
        )

    def local_sides(self, r: np.ndarray) -> np.ndarray:
        """Return F + k_0 W of every side on its interface: eqs (16), (17), or the law."""
        g = np.asarray(2.0 * self.sides.mean(r) - r)  # (16), (17)
        first, second = self.sides.joints
        force = self.weight * self.joint_fields(r)[1]
        g[first], g[second] = r[first] + 2.0 * force, r[second] - 2.0 * force
        return g

    def joint_fields(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Jump from the last state, m, and traction, Pa, on the search directions, (3, points)."""
        first, second = self.sides.joints
        series = 1.0 / self.compliance.sum(axis=0) / self.weight
        moved = r[second] * self.compliance[1] - r[first] * self.compliance[0]
        source = series * (moved - self.state.slid)
        jump = self.law.resolvent(source, series, self.state.history)
        return jump, source - series * jump

    def update(self) -> np.ndarray | None:
        """Adapt the search directions to the status of links and joints."""
        links, one_sided = self.stack.links, self.stack.one_sided
        known = self.status is not None
        tension = np.clip(self.z, links.lower, links.upper)
        slack = np.where(one_sided, (tension - self.z) / self.across, 0.0)
        taut = ~one_sided | (slack == 0.0)
        other = taut != self.status if known else np.ones(taut.size, dtype=bool)
        changed, of = self.team.total(np.array([np.count_nonzero(other), taut.size], dtype=float))
        g = self.local_sides(self.r)
        held, force = 0.5 * (g + self.r), 0.5 * (g - self.r)  # k_0 W and F
        joints_changed = self.update_joints()
        if not changed and not joints_changed:
            return None
        old, relative = self.k0, self.across / links.stiffness
        last = known and changed < LAST * of
        minor = last and not joints_changed and self.slack_direction == SOFTEST
        if changed:
            if last:
                self.slack_direction = SOFTEST
            elif known and changed < MINOR_CHANGE * of:
                self.slack_direction = max(SOFTEST, SOFTER * self.slack_direction)
            self.status, soft = taut, self.slack_direction
            relative = np.where(one_sided, np.where(taut, TAUT, soft), 1.0)
            if not minor:
                self.look_behind(np.where(taut, 1.0, soft / (1.0 + soft)))
        self.direct(relative)
        # the same tensions, slacks, forces and displacements with the new directions
        self.z = np.where(one_sided, tension - self.across * slack, tension)
        self.r = self.k0.matrix @ (old.inverse_root @ (old.inverse_root @ held)) - force
        return np.append(other if minor else np.ones_like(other), np.full(self.r.size, not minor))

    def update_joints(self) -> bool:
        """Adapt the search directions of joints to the tangents; return whether any changed."""
        jump = self.law.opened(self.joint_fields(self.r)[0])
        tangent, changed = np.zeros_like(jump), False
        for law, at in zip(self.law.laws, self.law.points, strict=True):
            tangent[:, at] = law_stiffness(law, jump[:, at], self.state.history[: law.n_state, at])
        for index, sides in self.directions(tangent).items():
            ratio = np.concatenate(sides) / np.concatenate(self.joint_k[index])
            if max(ratio.max(), 1.0 / ratio.min()) > CHANGE:
                self.joint_k[index], changed = sides, True
        return changed

    def directions(self, tangent: np.ndarray) -> dict[int, tuple[np.ndarray, ...]]:
        """Search directions of both sides of all joints, given :func:`law_stiffness` of all."""
        total: dict[int, np.ndarray] = defaultdict(lambda: np.zeros((3, 1)))
        area: dict[int, float] = defaultdict(float)
        for _, face, at in self.joints:
            total[face.joint] += (tangent[:, at] @ face.weight)[:, None]
            area[face.joint] += face.weight.sum()
        return {
            index: joint_directions(
                face, self.bodies[index], tangent[:, at], total[face.joint] / area[face.joint]
            )
            for index, face, at in self.joints
        }

    def slack(self) -> np.ndarray:
        """Distance by which the ends of every link miss it, shape (rows,), m."""
        links = self.stack.links
        tension = np.clip(self.z, links.lower, links.upper)
        return np.asarray(np.where(self.stack.one_sided, np.abs(tension - self.z) / self.across, 0))

    def admissible(self, tension: np.ndarray) -> np.ndarray:
        """Tension within the limits of the links, N."""
        return np.asarray(np.clip(tension, self.stack.links.lower, self.stack.links.upper))

    def residual(
        self, iterate: LatinIterate, last: LatinIterate | None, distance: np.ndarray
    ) -> float:
        """Change of the forces relative to them, or of all relative to all, if that is larger.

        Bodies on soft joints move by far more than they deform: rounding of the motion, taken
        relative to the forces, would then hide that these have long converged. Bodies that slide
        away move without limit: relative to the forces are what is out of balance on perfect
        interfaces and, on joints, the distance, twice that of these forces from the laws.
        """
        size, links = max(self.size(iterate), REST * self.largest), np.zeros(iterate.tension.size)
        loose = self.k0.inverse_root @ self.sides.mean(iterate.force)
        astray = np.where(self.sides.perfect, loose, distance[links.size :])
        held = self.k0.inverse_root @ (iterate.push)  # k_0^(1/2) T u
        whole = np.hypot(size, self.norm(np.append(links, held)))
        change = self.norm(self._forces(iterate) - self._forces(last)) if last else 0.0
        change = max(change, float(np.linalg.norm(astray)))
        return max(change / (size or 1.0), self.norm(distance) / (whole or 1.0))

    def size(self, iterate: LatinIterate) -> float:
        """Measure the forces of a state and what they store in the bodies, J^1/2."""
        bodies = self.team.total(np.array([iterate.u @ (self.stack.stiffness @ iterate.u)]))[0]
        return float(np.hypot(self.norm(self._forces(iterate)), np.sqrt(max(float(bodies), 0.0))))

    def rounding(self, iterate: LatinIterate) -> float:
        """Bound what rounding leaves of a residual where bodies move but hardly deform."""
        moved = self.team.total(np.array([self.diagonal @ iterate.u**2]))[0]
        return min(UNSURE, ROUNDING * float(np.sqrt(moved)) / (self.size(iterate) or 1.0))

    def far(self, iterate: LatinIterate) -> bool:
        """Whether a body has moved by more than the size of the structure."""
        moved = self.team.concatenate(np.array([np.abs(iterate.u).max(initial=0.0)]))
        return float(moved.max()) > float(np.ptp(self.problem.position, axis=0).max())

    def pressure(self) -> np.ndarray:
        """Contact pressure at all points of all joints, Pa."""
        return np.asarray(-self.joint_fields(self.r)[1][0])

    def slide(self, load: np.ndarray, pressure: np.ndarray) -> Slide | None:
        """Slide under a load at the pressures before the step or at these, Pa; None if held."""
        return find_slide(self.problem, self.team.concatenate(load), self.state.pressure, pressure)

    def norm(self, value: np.ndarray) -> float:
        """Norm over all processes of what links, then sides have, shape (rows + m,)."""
        links, sides = value[: self.z.size], value[self.z.size :]
        return float(np.sqrt(self.team.total(np.array([links @ links]))[0] + sides @ sides))

    def _forces(self, iterate: LatinIterate) -> np.ndarray:
        """Tensions, less the prestress, and forces in the energy norm, shape (rows + m,)."""
        links = self.stack.links
        change = (iterate.tension - links.prestress) / np.sqrt(links.stiffness)
        return np.append(change, self.k0.inverse_root @ iterate.force)

    def distance(self, z: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Difference from z and r in the energy norm, shape (rows + m,)."""
        links = np.where(self.stack.one_sided, (z - self.z) / np.sqrt(self.across), 0.0)
        return np.concatenate([links, self.k0.inverse_root @ (r - self.r)])

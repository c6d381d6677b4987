r"""Micro-macro LATIN: a local stage for links and laws, a linear stage for the structure."""

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
    ALONE,
    Factors,
    ProcessGroup,
    stack_substructures,
)
from multiscale.macro.substructures.stepping import JointState

FIRST, TAUT, SLACK = 1.0, 10.0, 0.05
"""Search direction of a link relative to the stiffness of the link: at first, and by status."""

MAJOR_INTERVAL, MINOR_INTERVAL = 8, 4
"""Iterations until the status is checked again, after it changed in many links or in few."""

CHANGE = 2.0
"""Factor of change of the directions in a joint above which they are updated."""

MINOR_CHANGE, SOFTER, SOFTEST = 3e-2, 0.3, 3e-3
"""If less than this share of the links changes its status, the direction of slack links is
multiplied by this factor, down to this: it tends to the tangent, which systems near mechanisms
need."""

LAST = 1e-3
"""If less than this share changes, the direction of slack links falls to the softest at once; the
stiffness of interfaces and the iterates of the acceleration stay from then on."""

REST = 1e-2
"""Least reference of the residual, relative to the largest forces of the steps before: a step that
removes all load has no forces."""

ROUNDING, UNSURE = 1e3 * np.finfo(float).eps, 1e-6
"""Rounding of the forces relative to the displacement in the norm of the diagonal of the stiffness,
measured on blocks on joints a million times softer; and the largest allowance for it: without a
limit, a body that moves away would count as in equilibrium."""


class LatinIterate(NamedTuple):
    """State after the linear stage."""

    u: np.ndarray  # displacement of the substructures of this process, (n,), m
    tension: np.ndarray  # forces of their links, (rows,), N
    force: np.ndarray  # on all sides of all interfaces, (m,), N
    push: np.ndarray  # k_0 T u on these sides, (m,), N


class Latin:
    r"""A problem prepared for LATIN iterations of :math:`x = (z, r)`.

    The *local stage* solves links, :math:`z = \tau - l \lambda`, and interfaces,
    :math:`r = k_0 T u - F`; the *linear stage* solves the substructures and the coarse forces.
    """

    def __init__(
        self, problem: CutProblem, team: ProcessGroup = ALONE, *, coarse: bool = True
    ) -> None:
        self.problem, self.team, self.coarse_wanted = problem, team, coarse
        self.stack, self.basis = stack_substructures(problem, team), coarse_basis(problem)
        self.sides, self.rows = self.stack.sides, self.stack.rows
        self.factors = Factors(), Factors(), Factors()
        links = self.stack.links
        self.diagonal = self.stack.stiffness.diagonal()
        self.pull, self.lift = csr_array(links.operator.T), csr_array(self.stack.trace.T)
        # joints, their laws, and the committed state
        self.law, self.weight = problem.law, problem.weight
        self.state = JointState.at_rest(problem)
        bodies = [body_stiffness(problem, joint) for joint in problem.joints]
        self.bodies = np.concatenate([np.zeros((2, 3, 0)), *bodies], axis=2)
        self.begin()

    def begin(self) -> None:
        """Set the first search directions, and z and r at rest."""
        links = self.stack.links
        rigid = np.full((3, self.weight.size), np.inf)
        self.joint_k = joint_directions(self.problem, self.bodies, rigid)
        self.perfect_k: dict[int, np.ndarray] = {}
        self.update_interfaces(np.ones(links.stiffness.size))
        self.set_directions(np.where(self.stack.one_sided, FIRST, 1.0))
        self.status: np.ndarray | None = None
        self.slack_direction = SLACK
        self.z, self.r = links.prestress.copy(), np.zeros(self.sides.m)
        self.largest = 0.0

    def resume(self, state: JointState) -> None:
        """Start from another state, without forces on perfect interfaces."""
        self.state, self.largest = state, 0.0
        substructures = self.problem.substructures
        u = [state.unknowns[substructures[owner].unknown] for owner in self.stack.local]
        moved = self.stack.trace @ np.concatenate(u)
        self.r = self.k0.matrix @ self.team.concatenate(moved)
        first, second = self.sides.joints
        self.r[first] -= self.weight * state.traction
        self.r[second] += self.weight * state.traction

    @property
    def n_coarse(self) -> int:
        """Size of the coarse problem."""
        return int(self.basis.shape[1])

    def update_interfaces(self, carries: np.ndarray) -> None:
        """Update the stiffness of perfect interfaces for a stiffness share of each link."""
        ground = np.zeros(self.sides.m)
        ground[self.sides.joints] = self.joint_k
        schur = schur_complements(
            self.stack, carries, diags_array(ground[self.rows]), self.factors[0]
        )
        self.perfect_k = interface_stiffness(self.stack, schur, self.perfect_k)

    def set_directions(self, relative: np.ndarray) -> None:
        """Set the search directions and factorise substructures and coarse problem."""
        links = self.stack.links
        self.across = relative * links.stiffness  # l
        self.k0 = side_stiffness(self.stack, self.perfect_k, self.joint_k)
        self.compliance = 1.0 / self.k0.matrix.diagonal()[self.sides.joints]  # of sides of joints
        k, across = links.stiffness, self.across
        effective = np.where(self.stack.one_sided, k * across / (k + across), k)
        sides = self.k0.matrix[self.rows][:, self.rows]
        self.solve = self.factors[1](self.stack.matrix(effective, sides))
        self.coarse = None
        if self.coarse_wanted and self.n_coarse:
            self.coarse = prepare_coarse(
                self.basis, self.k0.matrix, self.stack, self.solve, self.factors[2]
            )

    def iterate(self, load: np.ndarray) -> tuple[np.ndarray, np.ndarray, LatinIterate]:
        """Run the local and the linear stage from z and r."""
        links, k, across = self.stack.links, self.stack.links.stiffness, self.across
        one_sided = self.stack.one_sided
        # local stage: projection of the links, eq (15), and interfaces
        a = 2.0 * np.clip(self.z, links.lower, links.upper) - self.z
        g = self.local_sides(self.r)

        # linear stage: substructures, then coarse forces
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
        """Local stage of the interfaces: F + k_0 W on every side by (16), (17) or the law."""
        g = np.asarray(2.0 * self.sides.mean(r) - r)  # (16), (17)
        first, second = self.sides.joints
        force = self.weight * self.joint_fields(r)[1]
        g[first], g[second] = r[first] + 2.0 * force, r[second] - 2.0 * force
        return g

    def joint_fields(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Jump since the committed state, m, and traction, Pa, of the local stage, (3, points)."""
        first, second = self.sides.joints
        series = 1.0 / self.compliance.sum(axis=0) / self.weight
        moved = r[second] * self.compliance[1] - r[first] * self.compliance[0]
        source = series * (moved - self.state.slid)
        jump = self.law.resolvent(source, series, self.state.history)
        return jump, source - series * jump

    def update(self) -> np.ndarray | None:
        """Adapt the search directions to the status of links and joints."""
        # links that changed between taut and slack
        links, one_sided = self.stack.links, self.stack.one_sided
        known = self.status is not None
        tension = np.clip(self.z, links.lower, links.upper)
        slack = np.where(one_sided, (tension - self.z) / self.across, 0.0)
        taut = ~one_sided | (slack == 0.0)
        other = taut != self.status if known else np.ones(taut.size, dtype=bool)
        changed, of = self.team.total(np.array([np.count_nonzero(other), taut.size], dtype=float))
        g = self.local_sides(self.r)
        push, force = 0.5 * (g + self.r), 0.5 * (g - self.r)  # k_0 W and F
        joints_changed = self.update_joints()
        if not changed and not joints_changed:
            return None
        # new directions
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
                self.update_interfaces(np.where(taut, 1.0, soft / (1.0 + soft)))
        self.set_directions(relative)
        # z and r of the same tensions, slack, forces and displacements
        self.z = np.where(one_sided, tension - self.across * slack, tension)
        self.r = self.k0.matrix @ (old.inverse_root @ (old.inverse_root @ push)) - force
        return np.append(other if minor else np.ones_like(other), np.full(self.r.size, not minor))

    def update_joints(self) -> bool:
        """Adapt the search directions of joints to the tangents; return whether any changed."""
        jump = self.law.opened(self.joint_fields(self.r)[0])
        tangent, changed = np.zeros_like(jump), False
        for law, at in zip(self.law.laws, self.law.points, strict=True):
            tangent[:, at] = law_stiffness(law, jump[:, at], self.state.history[: law.n_state, at])
        following = joint_directions(self.problem, self.bodies, tangent)
        for at in self.problem.points:
            ratio = following[..., at] / self.joint_k[..., at]
            if max(ratio.max(), 1.0 / ratio.min()) > CHANGE:
                self.joint_k[..., at], changed = following[..., at], True
        return changed

    def slack(self) -> np.ndarray:
        """Slack of every link, shape (rows,), m."""
        links = self.stack.links
        tension = np.clip(self.z, links.lower, links.upper)
        return np.asarray(np.where(self.stack.one_sided, np.abs(tension - self.z) / self.across, 0))

    def admissible(self, tension: np.ndarray) -> np.ndarray:
        """Tension within the limits of the links, N."""
        return np.asarray(np.clip(tension, self.stack.links.lower, self.stack.links.upper))

    def residual(
        self, iterate: LatinIterate, last: LatinIterate | None, distance: np.ndarray
    ) -> float:
        """Larger of two residuals: in the forces, and the distance of both stages."""
        # bodies on soft joints move far more than they deform: the distance is relative to forces
        # and displacements; bodies that slide away move without limit: other terms are relative to
        # the forces
        size, links = max(self.size(iterate), REST * self.largest), np.zeros(iterate.tension.size)
        # forces: change in the iteration, imbalance on perfect interfaces, distance on joints
        imbalance = self.k0.inverse_root @ self.sides.mean(iterate.force)
        on_sides = np.where(self.sides.perfect, imbalance, distance[links.size :])
        change = self.norm(self._forces(iterate) - self._forces(last)) if last else 0.0
        change = max(change, float(np.linalg.norm(on_sides)))
        # forces and displacements
        moved = self.k0.inverse_root @ (iterate.push)  # k_0^(1/2) T u
        whole = np.hypot(size, self.norm(np.append(links, moved)))
        return max(change / (size or 1.0), self.norm(distance) / (whole or 1.0))

    def size(self, iterate: LatinIterate) -> float:
        """Energy norm of the forces and of the strain of the bodies, J^1/2."""
        bodies = self.team.total(np.array([iterate.u @ (self.stack.stiffness @ iterate.u)]))[0]
        return float(np.hypot(self.norm(self._forces(iterate)), np.sqrt(max(float(bodies), 0.0))))

    def rounding(self, iterate: LatinIterate) -> float:
        """Estimate the rounding of the residual where bodies move but hardly deform."""
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
        """Sliding motion under a load at the pressures before the step or at these, Pa, if any."""
        force = self.problem.sum_up([self.team.concatenate(load)])
        return find_slide(self.problem, force, self.state.pressure, pressure)

    def norm(self, value: np.ndarray) -> float:
        """Norm over all processes of values of links, then sides, shape (rows + m,)."""
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

r"""One load increment: Newton's iteration for geometry, material, contact and friction at once.

Unknowns are the displacement :math:`u` and, if the load is prescribed, the approach
:math:`\delta`. The contact forces are the internal forces :math:`f(u)` at the surface. With the
pressure force :math:`p = -n \cdot f`, the gap :math:`g`, the slip :math:`w` of the step tangential
to the obstacle and :math:`f_t` the tangential part of the force,

.. math::
    p = \max(0,\, p - \rho_n g), \qquad
    f_t = \Pi_{\mu p}(f_t - \rho_t w),    \tag{1}

with the projection :math:`\Pi` onto the disc of radius :math:`\mu p`: eqs (4)-(5) of the source
with Coulomb friction. Normals and slips are those of the current configuration.

References
----------
.. [1] P. Alart and A. Curnier, Comput. Methods Appl. Mech. Eng. 92 (1991) 353-375,
   doi:10.1016/0045-7825(91)90022-X: the equations (1).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from multiscale.convergence import Status
from multiscale.micro.finite.body import Body, Increment, Response
from multiscale.micro.finite.krylov import minimal_residual
from multiscale.micro.finite.obstacle import Meeting, Obstacle
from multiscale.micro.finite.reference import Constraint, Reference

__all__ = ["CellState", "Scene", "Target", "solve_increment"]

LEAST_DILATATION = 0.05
LARGEST_SHARE = 0.9999
HALVINGS = 7
FORCING = (1e-3, 0.1)
DIVERGED = 30.0
PATIENCE = 12  # iterations in which the error has to halve
LEAST_SPRING = 0.3 / 1.3  # share of the bound above which a spring helps the preconditioner
UNLOADED = 1e-3  # of the largest contact forces so far, below which forces are measured by them


@dataclass(frozen=True, eq=False)
class Scene:
    r"""What does not change along a path.

    Attributes
    ----------
    body : Body
    reference : Reference
    obstacle : Obstacle
    friction : float
        Local friction coefficient; 0 leaves out everything tangential.
    weights : tuple of float
        :math:`\rho_n` and :math:`\rho_t`, N/m.
    """

    body: Body
    reference: Reference
    obstacle: Obstacle
    friction: float
    weights: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Target:
    """Where an increment ends: the load (N) or the approach (m), the slide (m) and its duration."""

    load: float | None
    approach: float | None
    slide: np.ndarray
    time_step: float = 0.0


@dataclass(frozen=True, eq=False)
class CellState:
    """A state of the cell in equilibrium, or the last iterate.

    Attributes
    ----------
    displacement : ndarray, shape (nx, layers, 3, ny)
        m.
    approach : float
        m.
    slide : ndarray, shape (2,)
        Of the obstacle, m.
    material : Any
        Internal variables of the body; None without any.
    force : ndarray, shape (nx, 3, ny)
        Of the obstacle on the body, N.
    active, slipping : ndarray of bool, shape (nx, ny)
        Contact nodes, and those of them that slip.
    dissipation : float
        Work of friction since the first state, J.
    status : Status
    residuals : tuple of float
        Forces out of balance and violations of contact, relative to the contact forces.
    linear_iterations : int
    flowing : float
        Share of the Gauss points that flow.
    peak : float
        Largest norm of the contact forces so far, N.
    """

    displacement: np.ndarray
    approach: float
    slide: np.ndarray
    material: Any
    force: np.ndarray
    active: np.ndarray
    slipping: np.ndarray
    dissipation: float = 0.0
    status: Status = Status.MAX_ITERATIONS
    residuals: tuple[float, ...] = ()
    linear_iterations: int = 0
    flowing: float = 0.0
    peak: float = 0.0


def solve_increment(
    scene: Scene,
    start: CellState,
    target: Target,
    guess: tuple[np.ndarray, float] | None = None,
    *,
    max_iterations: int = 40,
    tolerance: float = 1e-8,
) -> CellState:
    """Take a cell from one state of equilibrium to the next.

    Parameters
    ----------
    scene : Scene
    start : CellState
    target : Target
    guess : tuple, optional
        Contact nodes and approach to start from, for a cell not in contact yet.
    max_iterations : int
        Newton iterations.
    tolerance : float
        Bound on forces out of balance and on violations of (1), relative to the norm of the
        contact forces.

    Returns
    -------
    CellState
        Its status says whether it is in equilibrium.
    """
    step = scene.body.begin(start.material, target.time_step)
    delta = start.approach if target.approach is None else target.approach
    active = None
    if guess is not None:
        active, delta = guess
    now = _evaluate(scene, step, start, target, start.displacement, delta, active)
    residuals: list[float] = []
    linear, status = 0, Status.MAX_ITERATIONS
    for _ in range(max_iterations):
        residuals.append(now.error)
        if not np.isfinite(now.error):
            status = Status.NOT_FINITE
            break
        if now.error <= tolerance:
            status = Status.CONVERGED
            break
        if len(residuals) > 5 and now.error > DIVERGED * min(residuals):
            status = Status.STALLED
            break
        if len(residuals) > PATIENCE and (
            min(residuals[-PATIENCE:]) > 0.5 * min(residuals[:-PATIENCE])
        ):
            status = Status.STALLED
            break
        before = residuals[-2] if len(residuals) > 1 else np.inf
        forcing = min(FORCING[1], max(FORCING[0], 0.9 * (now.error / before) ** 1.5))
        move, shift, iterations = now.newton_step(forcing, 0.1 * tolerance)
        linear += iterations
        found = _search(scene, step, start, target, now, move, shift)
        if found is None:
            status = Status.STALLED
            break
        now = found
    return CellState(
        now.u,
        now.delta,
        target.slide,
        step.finish(now.u) if status is Status.CONVERGED else start.material,
        now.contact_force,
        now.active,
        now.slipping,
        start.dissipation + now.dissipated,
        status,
        tuple(residuals),
        linear,
        now.response.flowing,
        max(start.peak, float(np.linalg.norm(now.contact_force))),
    )


def _search(
    scene: Scene,
    step: Increment,
    start: CellState,
    target: Target,
    now: "_Iterate",
    move: np.ndarray,
    shift: float,
) -> "_Iterate | None":
    """Shorten a Newton step until no element folds and, with nothing to close, the error falls."""
    share = 1.0
    best: _Iterate | None = None
    for _ in range(HALVINGS):
        found = _evaluate(
            scene, step, start, target, now.u + share * move, now.delta + share * shift, None
        )
        if found.response.least_dilatation > LEAST_DILATATION:
            if now.opens or found.error <= (1.0 - 1e-3 * share) * now.error:
                return found
            if best is None or found.error < best.error:
                best = found
        share *= 0.5
    return best


def _evaluate(
    scene: Scene,
    step: Increment,
    start: CellState,
    target: Target,
    u: np.ndarray,
    delta: float,
    active: np.ndarray | None,
) -> "_Iterate":
    """Evaluate (1) and choose the contact nodes, and those that slip."""
    response = step.respond(u)
    force = response.force[:, -1]
    meeting = scene.obstacle.meet(u[:, -1], delta, target.slide)
    normal = meeting.normal
    pressure = -np.sum(force * normal, axis=1)
    trial = pressure - scene.weights[0] * meeting.gap
    if active is None:
        active = trial > 0.0
        if target.load and not active.any():  # something has to carry it
            active = trial == trial.max()
    iterate = _Iterate(
        scene,
        target,
        response,
        u,
        delta,
        meeting,
        active,
        pressure,
        np.zeros_like(active),
        UNLOADED * start.peak,
    )
    if scene.friction == 0.0:
        return iterate

    slip = u[:, -1] - start.displacement[:, -1]
    slip[:, :2] -= (target.slide - start.slide)[None, :, None]
    slip[:, 2] += delta - start.approach
    slip -= np.sum(slip * normal, axis=1)[:, None] * normal
    tangential = force + pressure[:, None] * normal
    pulled = tangential - scene.weights[1] * slip
    size = np.linalg.norm(pulled, axis=1)
    bound = scene.friction * np.maximum(trial, 0.0)
    slipping = active & (size > bound)
    return replace(
        iterate,
        slipping=slipping,
        slip=slip,
        direction=_directions(pulled, size, normal),
        bound=bound,
        share=np.where(slipping, bound / np.where(size > 0.0, size, 1.0), 0.0),
    )


def _directions(pulled: np.ndarray, size: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Find unit tangents along and across the pull; any where there is none."""
    floor = 1e-12 * float(size.max())
    sideways = np.zeros_like(pulled)
    sideways[:, 0], sideways[:, 2] = normal[:, 2], -normal[:, 0]
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    along = np.where((size > floor)[:, None], pulled / np.maximum(size, 1e-300)[:, None], sideways)
    return np.stack([along, np.cross(normal, along, axis=1)])


@dataclass(frozen=True, eq=False)
class _Iterate:
    """The equations at one displacement."""

    scene: Scene
    target: Target
    response: Response
    u: np.ndarray
    delta: float
    meeting: Meeting
    active: np.ndarray
    pressure: np.ndarray
    slipping: np.ndarray
    floor: float
    slip: np.ndarray | None = None
    direction: np.ndarray | None = None
    bound: np.ndarray | None = None
    share: np.ndarray | None = None

    @property
    def sticking(self) -> np.ndarray:
        """Contact nodes held in all directions."""
        return np.asarray(self.active & ~self.slipping)

    @property
    def dissipated(self) -> float:
        """Work of friction in the step, J."""
        if self.slip is None:
            return 0.0
        return -float(np.sum(self.contact_force * self.slip))

    @cached_property
    def contact_force(self) -> np.ndarray:
        """Force of the obstacle on the body, shape (nx, 3, ny), N."""
        return np.asarray(np.where(self.active[:, None], self.response.force[:, -1], 0.0))

    @cached_property
    def scale(self) -> float:
        """Norm of the contact forces, N; what the load alone would make if they vanish."""
        norm = max(float(np.linalg.norm(self.contact_force)), self.floor)
        if self.target.load is not None:
            return max(norm, self.target.load / float(np.sqrt(self.active.size)))
        return norm

    @cached_property
    def missing(self) -> float:
        """What the vertical contact force still has to change by, N; 0 at a given approach."""
        if self.target.load is None:
            return 0.0
        return -self.target.load - float(self.contact_force[:, 2].sum())

    @cached_property
    def constraint(self) -> Constraint:
        """Held motions and springs, for the preconditioner."""
        if self.direction is None or self.share is None:
            rows, held = self.meeting.normal[None], self.active[None]
            spring = np.zeros(held.shape)
        else:
            rows = np.concatenate([self.meeting.normal[None], self.direction])
            stick = self.sticking
            held = np.stack([self.active, stick, stick])
            spring = np.zeros(held.shape)
            strong = self.share > LEAST_SPRING
            spring[2] = np.where(strong, self.spring, 0.0)
        return Constraint(
            self.scene.reference, rows, held, spring, carries_load=self.target.load is not None
        )

    @cached_property
    def spring(self) -> np.ndarray:
        """Resistance of a slipping node against motion across its slip, N/m."""
        assert self.share is not None
        share = np.minimum(self.share, LARGEST_SHARE)
        return np.asarray(self.scene.weights[1] * share / (1.0 - share))

    @cached_property
    def distance(self) -> np.ndarray:
        """What the held motions still have to do, m."""
        rows = [np.where(self.active, self.meeting.gap, 0.0)]
        if self.direction is not None and self.slip is not None:
            along = np.sum(self.direction * self.slip, axis=2)
            rows += list(np.where(self.sticking, -along, 0.0))
        return np.stack(rows)

    @cached_property
    def opens(self) -> bool:
        """Whether a held motion is out of place by more than rounding."""
        lag = np.abs(self.distance).max()
        return bool(lag > 1e-10 * max(abs(self.delta), float(np.abs(self.u[:, -1]).max()), lag))

    @cached_property
    def residual(self) -> np.ndarray:
        """Forces out of balance in the form of the Newton equations, N."""
        residual = self.response.force.copy()
        if self.direction is not None and self.share is not None and self.bound is not None:
            top = residual[:, -1]
            along, across = self.direction
            force = top.copy()
            lag = self.scene.friction * np.sum(self.meeting.normal * force, axis=1)
            stretch = 1.0 / (1.0 - np.minimum(self.share, LARGEST_SHARE)) - 1.0
            turn = np.sum(across * force, axis=1) * stretch
            change = lag[:, None] * along + turn[:, None] * across
            top += np.where(self.slipping[:, None], change, 0.0)
        self._remove_held(residual)
        return residual

    @cached_property
    def error(self) -> float:
        """Residual of (1), relative to the contact forces."""
        balance = self.response.force.copy()
        top = balance[:, -1]
        top[:] = np.where(self.active[:, None], 0.0, top)
        forces = float(np.vdot(balance, balance))
        normal_part = (
            self.contact_force
            + np.where(self.active, self.pressure, 0.0)[:, None] * self.meeting.normal
        )
        if self.direction is None or self.bound is None:
            forces += float(np.vdot(normal_part, normal_part))
        else:
            off = normal_part - self.bound[:, None] * self.direction[0]
            off = np.where(self.slipping[:, None], off, 0.0)
            forces += float(np.vdot(off, off))
        weight = np.array([self.scene.weights[0]] + [self.scene.weights[1]] * 2)
        held = self.distance * weight[: len(self.distance), None, None]
        pulled = np.minimum(np.where(self.active, self.pressure, 0.0), 0.0)
        total = np.sqrt(forces + float(np.vdot(held, held)) + float(np.vdot(pulled, pulled)))
        missing = abs(self.missing) / self.target.load if self.target.load else 0.0
        if total == 0.0 and missing == 0.0:
            return 0.0
        return max(total / self.scale if self.scale > 0.0 else 1.0, missing)

    def _remove_held(self, vector: np.ndarray) -> None:
        """Leave out the equations of held motions, in place."""
        top = vector[:, -1]
        along = np.sum(self.meeting.normal * top, axis=1)
        top -= np.where(self.active, along, 0.0)[:, None] * self.meeting.normal
        if self.direction is not None:
            top[:] = np.where(self.sticking[:, None], 0.0, top)

    def _apply(self, x: np.ndarray, shift: float) -> tuple[np.ndarray, float]:
        """Newton's matrix times a step, and the change of the vertical contact force."""
        change = self.response.tangent(x)
        top = change[:, -1]
        vertical = float(np.where(self.active, top[:, 2], 0.0).sum())
        self._turn(x[:, -1], top)
        if self.direction is not None:
            along, across = self.direction
            lag = self.scene.friction * np.sum(self.meeting.normal * top, axis=1)
            turn = self.spring * (np.sum(across * x[:, -1], axis=1) + across[:, 2] * shift)
            more = lag[:, None] * along + turn[:, None] * across
            top += np.where(self.slipping[:, None], more, 0.0)
        self._remove_held(change)
        return change, vertical

    def _turn(self, x: np.ndarray, top: np.ndarray) -> None:
        """Add what the turning of the normals on a curved obstacle changes."""
        if self.meeting.curvature is None:
            return
        xx, xy, yy = self.meeting.curvature
        factor = np.where(self.active, self.pressure, 0.0) * self.meeting.normal[:, 2]
        top[:, 0] -= factor * (xx * x[:, 0] + xy * x[:, 1])
        top[:, 1] -= factor * (xy * x[:, 0] + yy * x[:, 1])

    def newton_step(self, forcing: float, floor: float) -> tuple[np.ndarray, float, int]:
        """Solve the linear problem; return the step, that of the approach and the iterations."""
        shape, size = self.u.shape, self.u.size
        constraint = self.constraint
        weight = 1.0 / np.sqrt(max(int(self.active.sum()), 1))
        carries = constraint.carries_load

        def join(vector: np.ndarray, number: float) -> np.ndarray:
            return np.append(vector.reshape(-1), number)

        def apply(x: np.ndarray) -> np.ndarray:
            change, vertical = self._apply(x[:size].reshape(shape), x[size])
            return join(change, weight * vertical if carries else 0.0)

        def precondition(r: np.ndarray) -> np.ndarray:
            z, shift = constraint.solve(r[:size].reshape(shape), r[size] / weight)
            return join(z, shift)

        first, shift = constraint.solve(-self.residual, self.missing, self.distance)
        x = join(first, shift)
        rest = join(-self.residual, weight * self.missing if carries else 0.0) - apply(x)
        weights = self.scene.weights[0] * float(np.linalg.norm(self.distance))
        size_now = np.hypot(float(np.linalg.norm(self.residual)), weights)
        goal = max(forcing * size_now, floor * self.scale)
        y, iterations = minimal_residual(apply, rest, precondition, goal=goal)
        x += y
        return x[:size].reshape(shape), float(x[size]), iterations + 1

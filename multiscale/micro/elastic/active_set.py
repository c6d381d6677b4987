r"""Frictionless contact of an elastic body with a rigid obstacle, by a primal-dual active set.

With contact forces :math:`\lambda` along the obstacle's normals and the approach :math:`\delta`, of
which either the load :math:`F` or the approach is prescribed,

.. math::
    K u + N^t \lambda = 0, \qquad
    0 \le \lambda \perp g - b\,\delta - N u \ge 0, \qquad b^t \lambda = F,    \tag{1}

eqs (4)-(5) of the source with :math:`H = -N^t` and :math:`r = \lambda`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Protocol

import numpy as np

from multiscale.convergence import Status, check_limits
from multiscale.micro.elastic.flat_contact import solve_flat
from multiscale.micro.path import ContactState, untouched
from multiscale.numerics.krylov import conjugate_gradients
from multiscale.numerics.vectors import advance, dot, turn

_COARSE = 1e-2  # reduction of the residual before the first check of the active set
_INNER = 1e-4  # tolerance of the surface problems in the preconditioner: no more iterations
_BLOCKS = 5  # exchanges of all wrong nodes without a smaller number of wrong nodes
_LINEAR_LIMIT = 5000  # conjugate-gradient iterations on all active sets of a solve together
_PATIENCE = 300  # iterations without a smaller residual, which then is rounding; 50 to 100 are
# usual for a Poisson's ratio of .4999 on slopes of 1/2
_SMALLER = 0.9  # times the least residual so far
_ROUNDING = 64.0  # times the precision: relative error of the recurrence of the residual


Constrained = Callable[..., tuple[np.ndarray, float]]
"""``(out_of_balance, missing, out, distance)`` to displacement, m, and change of the approach, m.

Approximate inverse in the space of displacements that satisfy the constraints, up to ``distance``
at the active nodes, m, for forces out of balance, N, and a missing load, N; the displacement may be
written into ``out``."""


class Inverse(Protocol):
    """Approximate inverse of a stiffness under constraints, as a preconditioner of contact."""

    def guess(
        self,
        gap: np.ndarray,
        closing: np.ndarray,
        *,
        load: float | None,
        approach: float | None,
        start: ContactState,
    ) -> tuple[np.ndarray, float]:
        """Return contact forces, N, and approach, m, of a similar, cheaper problem."""

    def constrain(self, closing: np.ndarray, active: np.ndarray, *, loaded: bool) -> Constrained:
        """Return the inverse on an active set, under a load or at a fixed approach."""


@dataclass(frozen=True)
class ElasticBody:
    """Operators of (1), for any discretisation; contact quantities have an entry per node."""

    apply: Callable[..., np.ndarray]  # apply(u, out) returns K u, possibly written into out
    trace: Callable[[np.ndarray], np.ndarray]  # N u, displacement along the obstacle's normals
    add: Callable[[np.ndarray, np.ndarray], None]  # vector += N^t values, in place
    inverse: Inverse
    shape: tuple[int, ...]
    dtype: type[np.floating] = np.float64  # of the iterations; the last is in double precision


@dataclass(frozen=True)
class ReferenceInverse:
    """Exactly constrained inverse of a stiffness :math:`K_0` equal or spectrally close to K.

    ``solve(force, correct, out)`` returns :math:`K_0^{-1} (f - N^t l)` for forces f, ``None`` for
    zero, possibly in ``out``; ``correct`` returns the contact forces l for :math:`N K_0^{-1} f`.
    """

    solve: Callable[..., np.ndarray]
    compliance: Callable[[np.ndarray], np.ndarray]  # C_0 = N K_0^-1 N^t
    surface_stiffness: Callable[[np.ndarray], np.ndarray]  # approximates its inverse, symmetric

    def guess(
        self,
        gap: np.ndarray,
        closing: np.ndarray,
        *,
        load: float | None,
        approach: float | None,
        start: ContactState,
    ) -> tuple[np.ndarray, float]:
        """Solve the contact problem with the compliance of :math:`K_0`, on the surface only."""
        forces = start.reference_force
        flat = solve_flat(self.compliance, gap, closing, load=load, approach=approach, start=forces)
        return flat.value, flat.approach

    def constrain(self, closing: np.ndarray, active: np.ndarray, *, loaded: bool) -> Constrained:
        """Return the inverse on an active set, under a load or at a fixed approach."""

        @cache
        def unit() -> np.ndarray:  # contact forces under a unit approach, N/m
            return self._surface_solve(closing, active)

        # z = K_0^-1 (r - N_A^t l) with N_A z + b d_delta = 0, where b^t l balances the load
        def invert(
            out_of_balance: np.ndarray,
            missing: float,
            out: np.ndarray,
            distance: np.ndarray | float = 0.0,
        ) -> tuple[np.ndarray, float]:
            shift = 0.0

            def correct(trace: np.ndarray) -> np.ndarray:
                nonlocal shift
                contact = self._surface_solve(trace - distance, active)
                if loaded:
                    shift = missing - float(np.vdot(closing, contact))
                    shift /= float(np.vdot(closing, unit()))
                    contact += shift * unit()
                return contact

            z = self.solve(out_of_balance, correct, out)
            return z, shift

        return invert

    def _surface_solve(self, right_hand_side: np.ndarray, active: np.ndarray) -> np.ndarray:
        """Solve C_AA l = d on the active nodes by conjugate gradients, in single precision."""
        size = float(np.max(np.abs(right_hand_side))) or 1.0  # avoids underflow of squares
        r = np.where(active, right_hand_side / size, 0.0).astype(np.float32)

        def among_active(operator: Callable[[np.ndarray], np.ndarray]) -> Callable[..., np.ndarray]:
            return lambda force: np.where(active, operator(force), 0.0)

        contact, _ = conjugate_gradients(
            among_active(self.compliance),
            r,
            among_active(self.surface_stiffness),
            goal=_INNER * float(np.linalg.norm(r)),
            limit=1000,
        )
        return size * contact.astype(float)


def solve_elastic_contact(
    body: ElasticBody,
    gap: np.ndarray,
    closing: np.ndarray,
    *,
    load: float | None = None,
    approach: float | None = None,
    start: ContactState | None = None,
    max_iterations: int = 60,
    tolerance: float = 1e-8,
) -> ContactState:
    """Press a body against a rigid obstacle without friction, (1)."""
    check_limits(tolerance, max_iterations)
    if (load is None) == (approach is None):
        raise ValueError(f"prescribe either the load or the approach, got {load=} and {approach=}")
    if start is None:
        nothing = np.zeros_like(gap)
        rest = np.broadcast_to(0.0, body.shape)  # takes no memory
        start = ContactState(rest, nothing, 0.0, nothing > 0.0, nothing)
    if load == 0.0 or (approach is not None and np.all(gap >= closing * approach)):
        return untouched(body.shape, gap, closing, approach)

    # first active set; from here on forces are relative to the norm of the guess
    guess, delta = body.inverse.guess(gap, closing, load=load, approach=approach, start=start)
    unit = float(np.linalg.norm(guess))  # N: avoids underflow
    delta, gap = delta / unit, gap / unit
    load = None if load is None else load / unit
    force, reference = start.force / unit, guess / unit
    active = reference + force - start.reference_force / unit > 0.0
    active = active if active.any() else reference > 0.0
    u, room = start.displacement / unit, np.empty((2, *body.shape), body.dtype)
    # only the contact forces of the last step are in balance
    out_of_balance = np.zeros(body.shape, body.dtype)

    residuals: list[float] = []
    n_linear, fewest, patience, changed = 0, gap.size + 1, _BLOCKS, True
    status, rounding = Status.MAX_ITERATIONS, _ROUNDING * float(np.finfo(body.dtype).eps)
    drift = rounding  # of the residual away from its recurrence
    stage = _LinearStage(body, gap, closing, active, load, tolerance)
    # M. Hintermüller, K. Ito and K. Kunisch, SIAM J. Optim. 13 (2002) 865-888; exchanges by least
    # index, where the number of wrong nodes does not fall, terminate for every positive definite
    # problem: J. J. Júdice and F. M. Pires, Comput. Oper. Res. 21 (1994) 587-596,
    # doi:10.1016/0305-0548(94)90106-6
    for _ in range(max_iterations):
        force, square = stage.split(out_of_balance, force)
        if changed:  # move onto the constraints of the new active set
            distance = np.where(active, gap - closing * delta - body.trace(u), 0.0)
            missing = stage.missing_load(force)
            z, shift = stage.invert(out_of_balance, missing, room[0], distance)
            delta += shift
            distance -= np.where(active, closing * shift + body.trace(z), 0.0)
            body.add(z, distance)
            advance(1.0, _flat(z), _flat(u), _flat(body.apply(z, room[1])), _flat(out_of_balance))
            force, square = stage.split(out_of_balance, force)
        # linear problem on the active set, then check the set
        delta, residual, iterations = stage.conjugate_gradients(
            u,
            delta,
            out_of_balance,
            force,
            room,
            square,
            _COARSE if patience > 0 else 0.0,
            _LINEAR_LIMIT - n_linear,
        )
        n_linear += iterations
        wrong = stage.wrong(u, delta, force)
        n_wrong = int(np.count_nonzero(wrong))
        if n_wrong == 0 or drift > tolerance:
            # residual from u instead of its recurrence
            body.add(u, np.where(active, gap - closing * delta - body.trace(u), 0.0))
            pushed = body.apply(u, np.frombuffer(room, count=u.size).reshape(u.shape))
            np.negative(pushed, out=out_of_balance, casting="same_kind")
            force = np.where(active, -body.trace(pushed), 0.0)
            _, square = stage.split(out_of_balance, np.zeros_like(gap))
            residual = stage.residual(square, force)
            drift = rounding * residual
        residuals.append(residual)
        if not np.isfinite(residual):
            status = Status.NOT_FINITE
            break
        if n_wrong == 0 and residual <= tolerance:
            status = Status.CONVERGED
            break
        if n_linear >= _LINEAR_LIMIT:
            status = Status.WORK_SPENT
            break

        # next active set: exchange all wrong nodes, or a single node
        if n_wrong == 0 and not changed and residual > 0.5 * residuals[-2]:
            status = Status.STALLED
            break
        changed = n_wrong > 0
        if n_wrong < fewest:
            fewest, patience = n_wrong, _BLOCKS
        else:
            patience -= changed
        if patience <= 0 and n_wrong:  # exchange single nodes by least index
            wrong &= np.arange(gap.size).reshape(gap.shape) == np.flatnonzero(wrong)[:1]
        if changed:
            active = active ^ wrong
            if load is not None and not active.any():  # at least one node carries the load
                distance = gap - closing * delta - body.trace(u)
                active = distance == distance.min()
            stage = _LinearStage(body, gap, closing, active, load, tolerance)

    u *= unit
    return ContactState(
        u,
        unit * np.maximum(force, 0.0),
        unit * delta,
        active,
        guess,
        status,
        tuple(residuals),
        n_linear,
    )


@dataclass(frozen=True, eq=False)
class _LinearStage:
    """Linear problem on an active set, for displacements that satisfy the constraints."""

    body: ElasticBody
    gap: np.ndarray
    closing: np.ndarray
    active: np.ndarray
    load: float | None
    tolerance: float

    def split(self, out_of_balance: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, float]:
        """Exchange nodal and contact forces; return contact forces and the squared residual."""
        self.body.add(out_of_balance, np.where(self.active, 0.0, force))
        carried = np.where(self.active, force, 0.0) + self.take(out_of_balance)
        return carried, dot(_flat(out_of_balance), _flat(out_of_balance))

    def take(self, vector: np.ndarray) -> np.ndarray:
        """Remove the contact forces at active nodes from nodal forces, in place; return them."""
        force = np.where(self.active, self.body.trace(vector), 0.0)
        self.body.add(vector, -force)
        return force

    def wrong(self, u: np.ndarray, delta: float, force: np.ndarray) -> np.ndarray:
        """Select active nodes in tension and penetrating inactive nodes, beyond the tolerance."""
        depth = self.closing * delta + self.body.trace(u) - self.gap
        pull, deep = (self.tolerance * float(np.max(size)) for size in (force, np.abs(depth)))
        return np.where(self.active, force < -pull, depth > deep)

    def missing_load(self, force: np.ndarray) -> float:
        """Return the missing load, N; 0 if the approach is prescribed."""
        return 0.0 if self.load is None else self.load - float(np.vdot(self.closing, force))

    def residual(self, square: float, force: np.ndarray) -> float:
        """Return forces out of balance over contact forces, at least the relative missing load."""
        scale = float(np.linalg.norm(force)) or 1.0
        missing = self.missing_load(force) / self.load if self.load else 0.0
        return max(float(np.sqrt(square)) / scale, abs(missing))

    @cached_property
    def invert(self) -> Constrained:
        """Approximate inverse on this active set."""
        return self.body.inverse.constrain(self.closing, self.active, loaded=self.load is not None)

    def conjugate_gradients(
        self,
        u: np.ndarray,
        delta: float,
        out_of_balance: np.ndarray,
        force: np.ndarray,
        room: np.ndarray,
        square: float,
        reduction: float,
        most: int,
    ) -> tuple[float, float, int]:
        """Reduce the residual by a factor, or to the tolerance while no node is wrong, in place."""
        p, p_delta, rz_old = room[1], 0.0, np.inf
        p[:] = 0.0
        best, patience, iteration = np.inf, _PATIENCE, 0
        residual = self.residual(square, force)
        last = max(self.tolerance, _ROUNDING * float(np.finfo(p.dtype).eps) * residual)
        if self.tolerance < residual < 2.0 * self.tolerance:  # margin for the recurrence
            last = 0.5 * residual
        target = max(last, reduction * residual)
        while True:
            if residual <= target and not np.any(self.wrong(u, delta, force)):
                target = last
            patience -= 1
            if residual < _SMALLER * best:
                best, patience = residual, _PATIENCE
            if iteration == most or not residual > target or patience == 0:
                return delta, residual, iteration
            # preconditioned residual, without motion of the constrained nodes by rounding
            missing = self.missing_load(force)
            z, shift = self.invert(out_of_balance, missing, room[0])
            self.body.add(z, np.where(self.active, -self.closing * shift - self.body.trace(z), 0.0))
            # conjugate direction and step
            rz = dot(_flat(out_of_balance), _flat(z)) + missing * shift
            turn(rz / rz_old, _flat(p), _flat(z))
            p_delta = shift + (rz / rz_old) * p_delta
            q = self.body.apply(p, room[0])
            reaction = self.take(q)  # the contact forces change by -alpha times this
            along = float(np.vdot(self.closing, reaction))
            curvature = dot(_flat(p), _flat(q)) - along * p_delta
            if curvature == 0.0:  # the residual is rounding
                return delta, residual, iteration
            alpha = rz / curvature
            square = advance(alpha, _flat(p), _flat(u), _flat(q), _flat(out_of_balance))
            force -= alpha * reaction
            delta += alpha * p_delta
            residual, rz_old = self.residual(square, force), rz
            iteration += 1


def _flat(vector: np.ndarray) -> np.ndarray:
    return vector.reshape(-1)

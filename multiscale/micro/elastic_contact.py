r"""Frictionless contact of an elastic body with a rigid obstacle, by a primal-dual active set.

Unknowns are the displacement :math:`u`, the nodal contact forces :math:`\lambda` along the
obstacle's normals and the approach :math:`\delta` of the obstacle:

.. math::
    K u + N^t \lambda = 0, \qquad
    0 \le \lambda \perp g - b\,\delta - N u \ge 0, \qquad b^t \lambda = F,    \tag{1}

eqs (4)-(5) of the source with :math:`H = -N^t` and :math:`r = \lambda`. Either the load :math:`F`
or the approach is prescribed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.convergence import Status
from multiscale.micro.contact_state import ContactState, untouched
from multiscale.micro.flat import solve_flat
from multiscale.numerics.krylov import conjugate_gradients
from multiscale.numerics.vectors import advance, dot, turn

__all__ = ["ElasticBody", "solve_elastic_contact"]

_LOOSE = 1e-2  # reduction of the residual before the active set is questioned for the first time
_INNER = (
    1e-4  # tolerance of the surface problems inside the preconditioner, which costs no iteration
)
_BLOCKS = 5  # exchanges of all wrong nodes that may pass without fewer of them
_LINEAR_LIMIT = 5000  # conjugate-gradient iterations on all active sets of a solve together
_PATIENCE = 300  # of them without a smaller residual: rounding has the last word; 50 to 100 are
# usual where Poisson's ratio is .4999 on slopes of one half
_SMALLER = 0.9  # times the least residual so far
_ROUNDING = np.finfo(float).eps  # residual below which the recurrence means nothing


@dataclass(frozen=True)
class ElasticBody:
    r"""The operators of (1), for any discretisation.

    Vectors are arrays of any shape, contact quantities arrays of one entry per contact node.

    Attributes
    ----------
    apply : callable
        ``apply(u, out)`` returns :math:`K u`, which ``out`` may hold.
    solve : callable
        ``solve(force, correct, out)`` applies :math:`K_0^{-1}`, with :math:`K_0` equal or
        spectrally close to :math:`K`. ``correct`` gets :math:`N K_0^{-1} f` and returns contact
        forces :math:`l`; the result is :math:`K_0^{-1} (f - N^t l)`, which ``out`` may hold.
        ``None`` stands for :math:`f = 0`.
    trace : callable
        :math:`u \mapsto N u`, the displacement along the obstacle's normals.
    add : callable
        ``add(vector, values)`` does ``vector += N^t values`` in place.
    compliance : callable
        :math:`\lambda \mapsto C_0 \lambda = N K_0^{-1} N^t \lambda`.
    surface_stiffness : callable, an approximate inverse of ``compliance``, symmetric and positive
    shape : tuple of int
    """

    apply: Callable[..., np.ndarray]
    solve: Callable[..., np.ndarray]
    trace: Callable[[np.ndarray], np.ndarray]
    add: Callable[[np.ndarray, np.ndarray], None]
    compliance: Callable[[np.ndarray], np.ndarray]
    surface_stiffness: Callable[[np.ndarray], np.ndarray]
    shape: tuple[int, ...]


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
    r"""Press a body against a rigid obstacle without friction.

    Parameters
    ----------
    body : ElasticBody
    gap : ndarray
        :math:`g`, distance along the obstacle's normal at first touch, m.
    closing : ndarray
        :math:`b`, share of the approach that closes the gap: the normal's component along the
        approach.
    load, approach : float
        :math:`F`, N, or :math:`\delta`, m; exactly one of them.
    start : ContactState, optional
    max_iterations : int
    tolerance : float
        Bound on the norm of the forces out of balance, relative to the norm of the contact forces,
        and on the load's error, relative to the load.

    Notes
    -----
    The active set starts from the problem with :math:`K_0`, solved on the surface alone; what the
    previous step told about the difference of the two problems is kept. On a given active set
    conjugate gradients run on the displacements that satisfy the constraints. Their preconditioner
    is exactly constrained: :math:`z = K_0^{-1} (r - N_A^t l)` with :math:`l` such that
    :math:`N_A z + b\,d\delta = 0` and :math:`b^t l` balances the load. If the number of changes
    does not fall, single nodes are exchanged by least index, which ends for every positive
    definite problem [2]_.

    References
    ----------
    .. [1] M. Hintermüller, K. Ito and K. Kunisch, SIAM J. Optim. 13 (2002) 865-888,
       doi:10.1137/S1052623401383558.
    .. [2] J. J. Júdice and F. M. Pires, Comput. Oper. Res. 21 (1994) 587-596,
       doi:10.1016/0305-0548(94)90106-6.
    """
    if (load is None) == (approach is None):
        raise ValueError(f"prescribe either the load or the approach, got {load=} and {approach=}")
    if start is None:
        nothing = np.zeros_like(gap)
        rest = np.broadcast_to(0.0, body.shape)  # takes no memory
        start = ContactState(rest, nothing, 0.0, nothing > 0.0, nothing)
    if load == 0.0 or (approach is not None and np.all(gap >= closing * approach)):
        return untouched(body.shape, gap, closing, approach)

    out_of_balance, room = np.zeros(body.shape), np.empty((2, *body.shape))
    body.add(out_of_balance, start.force)  # what the step before was in balance with
    u = start.displacement.copy()
    flat = solve_flat(
        body.compliance, gap, closing, load=load, approach=approach, start=start.reference_force
    )
    reference, delta = flat.value, flat.approach
    active = reference + start.force - start.reference_force > 0.0
    active = active if active.any() else reference > 0.0

    def balance() -> None:
        np.negative(body.apply(u, out_of_balance), out=out_of_balance)

    residuals: list[float] = []
    n_linear, fewest, patience, changed, sharp = 0, gap.size + 1, _BLOCKS, True, False
    status = Status.MAX_ITERATIONS
    stage = _LinearStage(body, closing, active, load)
    for _ in range(max_iterations):
        force = stage.split(out_of_balance)
        if changed:  # move onto the constraints of the new active set
            z, shift = stage.precondition(
                out_of_balance,
                force,
                room[0],
                np.where(active, gap - closing * delta - body.trace(u), 0.0),
            )
            u += z
            delta += shift
            body.add(u, np.where(active, gap - closing * delta - body.trace(u), 0.0))
            balance()
            force = stage.split(out_of_balance)
        target = (
            tolerance if sharp else max(tolerance, _LOOSE * stage.residual(out_of_balance, force))
        )
        delta, iterations = stage.conjugate_gradients(
            u, delta, out_of_balance, force, room, target, _LINEAR_LIMIT - n_linear
        )
        n_linear += iterations

        # active nodes that pull and inactive ones that penetrate, beyond the tolerance
        penetration = closing * delta + body.trace(u) - gap
        pull, deep = (tolerance * float(np.max(one)) for one in (force, np.abs(penetration)))
        wrong = np.where(active, force < -pull, penetration > deep)
        n_wrong = int(np.count_nonzero(wrong))
        if n_wrong == 0 and stage.residual(out_of_balance, force) <= tolerance:
            balance()  # what the recurrence says must be true of u itself
            force = stage.split(out_of_balance)
        residuals.append(stage.residual(out_of_balance, force))
        if not np.isfinite(residuals[-1]):
            status = Status.NOT_FINITE
            break
        if n_wrong == 0 and residuals[-1] <= tolerance:
            status = Status.CONVERGED
            break
        if n_linear >= _LINEAR_LIMIT:
            status = Status.WORK_SPENT
            break

        if sharp and n_wrong == 0 and len(residuals) > 1 and residuals[-1] > 0.5 * residuals[-2]:
            status = Status.STALLED
            break
        body.add(out_of_balance, force)
        changed, sharp = n_wrong > 0, sharp or n_wrong == 0
        if n_wrong < fewest:
            fewest, patience = n_wrong, _BLOCKS
        else:
            patience -= changed
        if patience <= 0 and n_wrong:  # exchange single nodes by least index
            sharp = True
            wrong &= np.arange(gap.size).reshape(gap.shape) == np.flatnonzero(wrong)[:1]
        if changed:
            active = active ^ wrong
            if load is not None and not active.any():  # somewhere the load must go
                distance = gap - closing * delta - body.trace(u)
                active = distance == distance.min()
            stage = _LinearStage(body, closing, active, load)

    return ContactState(
        u, np.maximum(force, 0.0), delta, active, reference, status, tuple(residuals), n_linear
    )


@dataclass(frozen=True)
class _LinearStage:
    """The linear problem on one active set, in the displacements that satisfy the constraints."""

    body: ElasticBody
    closing: np.ndarray
    active: np.ndarray
    load: float | None

    def split(self, out_of_balance: np.ndarray) -> np.ndarray:
        """Take the contact forces out of the forces out of balance, in place, and return them."""
        force = np.where(self.active, self.body.trace(out_of_balance), 0.0)
        self.body.add(out_of_balance, -force)
        return force

    def missing_load(self, force: np.ndarray) -> float:
        """Return the load not yet carried, N; 0 if the approach is prescribed."""
        return 0.0 if self.load is None else self.load - float(np.vdot(self.closing, force))

    def residual(self, out_of_balance: np.ndarray, force: np.ndarray) -> float:
        """Return forces out of balance over contact forces, or the load's error if larger."""
        scale = float(np.linalg.norm(force)) or 1.0
        missing = self.missing_load(force) / self.load if self.load else 0.0
        unbalanced = _flat(out_of_balance)
        return max(float(np.sqrt(dot(unbalanced, unbalanced))) / scale, abs(missing))

    def surface_solve(self, right_hand_side: np.ndarray) -> np.ndarray:
        """Solve C_AA l = d on the active nodes by conjugate gradients, in single precision."""
        size = float(np.max(np.abs(right_hand_side))) or 1.0  # so that no square can underflow
        r = np.where(self.active, right_hand_side / size, 0.0).astype(np.float32)

        def among_active(operator: Callable[[np.ndarray], np.ndarray]) -> Callable[..., np.ndarray]:
            return lambda force: np.where(self.active, operator(force), 0.0)

        found, _ = conjugate_gradients(
            among_active(self.body.compliance),
            r,
            among_active(self.body.surface_stiffness),
            goal=_INNER * float(np.linalg.norm(r)),
            limit=1000,
        )
        return size * found.astype(float)

    @cached_property
    def unit(self) -> np.ndarray:
        """Contact forces of the flat problem under a unit approach, N/m."""
        return self.surface_solve(self.closing)

    def precondition(
        self,
        out_of_balance: np.ndarray,
        force: np.ndarray,
        room: np.ndarray,
        distance: np.ndarray | float = 0.0,
    ) -> tuple[np.ndarray, float]:
        """Apply the exactly constrained inverse; return displacement, in ``room``, and approach."""
        shift = 0.0

        def correct(trace: np.ndarray) -> np.ndarray:
            nonlocal shift
            contact = self.surface_solve(trace - distance)
            if self.load is not None:
                missing = self.missing_load(force) - float(np.vdot(self.closing, contact))
                shift = missing / float(np.vdot(self.closing, self.unit))
                contact += shift * self.unit
            return contact

        z = self.body.solve(out_of_balance, correct, room)
        return z, shift

    def conjugate_gradients(
        self,
        u: np.ndarray,
        delta: float,
        out_of_balance: np.ndarray,
        force: np.ndarray,
        room: np.ndarray,
        target: float,
        most: int,
    ) -> tuple[float, int]:
        """Reduce the residual to ``target``; ``u`` and the forces are changed in place.

        ``room`` takes the direction p and, one after the other, z and q.
        """
        p, p_delta, rz_old = room[1], 0.0, np.inf
        p[:] = 0.0
        best, patience = np.inf, _PATIENCE
        for iteration in range(most):
            residual = self.residual(out_of_balance, force)
            patience -= 1
            if residual < _SMALLER * best:
                best, patience = residual, _PATIENCE
            if not residual > max(target, _ROUNDING) or patience == 0:
                return delta, iteration
            z, shift = self.precondition(out_of_balance, force, room[0])
            # the rounding and the inner tolerance must not move the constrained nodes
            self.body.add(z, np.where(self.active, -self.closing * shift - self.body.trace(z), 0.0))
            rz = dot(_flat(out_of_balance), _flat(z)) + self.missing_load(force) * shift
            turn(rz / rz_old, _flat(p), _flat(z))
            p_delta = shift + (rz / rz_old) * p_delta
            q = self.body.apply(p, room[0])
            reaction = self.split(q)  # the contact forces change by -alpha times this
            along = float(np.vdot(self.closing, reaction))
            curvature = dot(_flat(p), _flat(q)) - along * p_delta
            if curvature == 0.0:  # the residual is rounding, which moves nothing
                return delta, iteration
            alpha = rz / curvature
            advance(alpha, _flat(p), _flat(u), _flat(q), _flat(out_of_balance))
            force -= alpha * reaction
            delta += alpha * p_delta
            rz_old = rz
        return delta, most


def _flat(vector: np.ndarray) -> np.ndarray:
    return vector.reshape(-1)

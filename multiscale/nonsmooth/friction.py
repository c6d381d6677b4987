r"""Coulomb friction: a single function for all methods; the verifier decides on the status."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from time import perf_counter

import numpy as np
from scipy.sparse import bsr_array, csr_array, issparse

from multiscale.convergence import Solution, Status, check_limits
from multiscale.errors import CaseError
from multiscale.nonsmooth.coulomb import (
    closing_norm,
    natural_units,
    project_friction_cone,
    unit_step,
    verify_friction,
)
from multiscale.nonsmooth.friction_interior_point import friction_interior_point
from multiscale.nonsmooth.friction_methods import BURST, gauss_seidel, semismooth_newton
from multiscale.nonsmooth.friction_problem import Progress, ScaledFriction, scale_friction
from multiscale.nonsmooth.refusals import (
    THOROUGH,
    jamming,
    refuse_indefinite,
    refuse_out_of_range,
)

SAFETY = 0.5  # share of the tolerance that the methods aim at, so that the verifier agrees

FIRST_LANCZOS_STEPS = 20
"""Lanczos steps before a problem is solved, which detect only clear cases."""

INDEFINITE = (
    "delassus is indefinite: after scaling its diagonal to 1 it has the eigenvalue {value:.2e}, "
    "and contact {worst} carries {share:.0%} of its vector; check the masses there, W = H^T M^-1 H "
    "has no negative eigenvalue"
)

ROUNDED = 1e3
"""Error, relative to the rounding of the velocities, that is attributed to rounding."""

NEGATIVE = 1e-4
"""Negative eigenvalue, relative to the largest, that round-off in the data does not explain."""

GAIN = 20.0  # factor by which a burst of sweeps has to reduce the error to be followed by another

FULL, LARGE = 15.0, 200
"""Blocks per contact and contacts beyond which a factorisation costs as much as many solves."""

LARGEST_FACTORISED = 2000
"""Contacts beyond which so full a W is not factorised: the factors fill with the square."""

SOFTENING, SOFT_SWEEPS, SOFT_TOLERANCE = 0.05, 4000, 1e-4
"""Mobility added across the normals to see whether only friction prevents an answer, relative to
the mobility of the contact, with the limit of sweeps and the tolerance of this trial."""

CONTRAST = 1e3  # ratio of mobilities from which they count as the reason of a failure

CENTRES = (1.0, 10.0, 0.1, 3.0, 0.3, 30.0, 0.03)
"""Starts of the interior point along the axis of the cones, dimensionless."""


def _interior_point(
    problem: ScaledFriction, reaction: np.ndarray, progress: Progress, max_iterations: int = 60
) -> None:
    """Interior point, which needs no start, finished by Newton's method."""
    friction_interior_point(problem, progress, max_iterations)
    if progress.best is not None and progress.smallest > progress.target:
        semismooth_newton(problem, progress.best, progress, 15, regularisation=1e-10)


FRICTION_METHODS: dict[str, Callable[..., np.ndarray | None]] = {
    "gauss_seidel": gauss_seidel,
    "newton": partial(semismooth_newton, regularisation=1e-4),
    "interior_point": _interior_point,
}
"""Methods by name; ``"auto"`` uses all of them."""


def _run_single(
    method: str, problem: ScaledFriction, reaction: np.ndarray, progress: Progress, **limit: int
) -> None:
    """Run a method of ``FRICTION_METHODS``, with a limit of its iterations if it is given."""
    progress.trail.append(method)
    FRICTION_METHODS[method](problem, reaction, progress, **limit)


def _run_schedule(
    problem: ScaledFriction, reaction: np.ndarray, progress: Progress, max_iterations: int = 5000
) -> None:
    """Run cheap methods first, then robust methods, each limited by ``max_iterations``."""
    # bursts of sweeps while each reduces the error by GAIN
    progress.trail.append("gauss_seidel")
    for burst in range(max(1, max_iterations // BURST)):
        before = progress.residuals[-1]
        reaction = gauss_seidel(problem, reaction, progress, min(BURST, max_iterations))
        if progress.smallest <= progress.target:
            return
        if progress.residuals[-1] > before / GAIN and burst > 0:
            break

    def newton(regularisation: float) -> bool:
        progress.trail.append("newton")
        best = np.zeros_like(problem.velocity) if progress.best is None else progress.best
        semismooth_newton(problem, best, progress, min(15, max_iterations), regularisation)
        return progress.smallest <= progress.target

    # Newton steps, unless W is so full that a factorisation costs as much as many solves
    large = problem.friction.size > LARGE
    heavy = large and problem.columns.size > FULL * problem.friction.size
    if heavy and problem.friction.size > LARGEST_FACTORISED:
        return
    if not heavy and newton(1e-4):
        return
    # interior points from the centre of the cones; other centres where W is small
    for centre in CENTRES[:1] if large else CENTRES:
        progress.trail.append("interior_point")
        friction_interior_point(problem, progress, min(60, max_iterations), centre)
        if progress.smallest <= progress.target or newton(1e-10):
            return


def solve_friction(
    delassus: csr_array | np.ndarray,
    velocity: np.ndarray,
    friction: np.ndarray,
    *,
    method: str = "auto",
    tolerance: float = 1e-8,
    start: np.ndarray | None = None,
    max_iterations: int | None = None,
    callback: Callable[[int, float], None] | None = None,
) -> Solution:
    r"""Solve contact with Coulomb friction in two or three dimensions.

    Find the impulses :math:`r` and relative velocities :math:`u` with

    .. math::
        u = W r + q, \qquad K_\mu \ni r \perp u + \mu \|u_T\| n \in K_\mu^*.    \tag{1}

    Parameters
    ----------
    delassus : csr_array or ndarray, shape (d * contacts, d * contacts)
        :math:`W`, 1/kg, positive semi-definite; d = 2 or 3 components per contact, normal first.
    velocity : ndarray, shape (d * contacts,)
        :math:`q`, the relative velocity without impulses, m/s; opening positive.
    friction : ndarray, shape (contacts,), :math:`\mu \ge 0`, dimensionless
    method : str
        ``"auto"``: bursts of Gauss-Seidel sweeps, a few Newton steps, and the interior point that
        treats the normal direction separately, finished by Newton's method, each for as long as it
        reduces the error; or a single method of ``FRICTION_METHODS``.
    tolerance : float, bound on the numbers of :func:`verify_friction`; dimensionless
    start : ndarray, shape (d * contacts,), optional
        First :math:`r`, N s; zero if not given. Interior points start from their centre.
    max_iterations : int, optional, iteration limit of each method; its default if not given
    callback : callable, optional, called as ``callback(iteration, residual)``

    Returns
    -------
    Solution
        ``value`` is the best :math:`r`, shape (d * contacts,), N s, even where the status, by the
        verifier, is not ``CONVERGED``; ``INFEASIBLE`` and ``JAMMED`` come with a certificate in
        ``detail``. Where W is singular the impulses need not be unique: compare velocities.

    Raises
    ------
    CaseError
        If the data do not fit, are not finite, W is indefinite, or the impulses are out of range.

    Examples
    --------
    A mass of 2 kg hits the ground at 1 m/s while it slides at 3 m/s:

    >>> W, q = np.diag([0.5, 0.5]), np.array([-1.0, 3.0])
    >>> solve_friction(W, q, np.array([0.5])).unwrap()
    array([ 2., -1.])
    """
    check_limits(tolerance, max_iterations)
    delassus, velocity, friction = _checked(delassus, velocity, friction)
    if start is not None and np.shape(start) != velocity.shape:
        raise ValueError(f"start must have shape {velocity.shape}, got {np.shape(start)}")
    if method != "auto" and method not in FRICTION_METHODS:
        raise CaseError(f"method {method!r} does not exist; known: {['auto', *FRICTION_METHODS]}")
    run = _run_schedule if method == "auto" else partial(_run_single, method)
    if max_iterations is not None:
        run = partial(run, max_iterations=max_iterations)
    solution, problem = approximate_friction(
        delassus, velocity, friction, tolerance=tolerance, start=start, run=run, callback=callback
    )
    if solution.converged or problem is None:
        return solution
    _refuse_indefinite(problem, THOROUGH)
    if certificate := jamming(problem):
        return replace(solution, status=certificate[0], detail=certificate[1])
    reason = _rounding(delassus, velocity, solution, friction.size) or _softened(problem)
    solution = replace(solution, detail=reason)
    if max_iterations is not None and solution.status is Status.STALLED:
        return replace(solution, status=Status.MAX_ITERATIONS)
    return solution


def approximate_friction(
    delassus: csr_array,
    velocity: np.ndarray,
    friction: np.ndarray,
    *,
    tolerance: float,
    start: np.ndarray | None,
    run: Callable[[ScaledFriction, np.ndarray, Progress], None] = _run_schedule,
    callback: Callable[[int, float], None] | None = None,
) -> tuple[Solution, ScaledFriction | None]:
    """Return the best answer without a reason, and the scaled problem if it is open."""
    started = perf_counter()
    if friction.size == 0:
        return Solution(velocity, Status.CONVERGED, (0.0,), (0.0,)), None
    contacts, dim = friction.size, velocity.size // friction.size

    if np.all(velocity[::dim] >= 0.0):  # nothing closes: r = 0 is an answer
        return _conclude(delassus, velocity, friction, np.zeros_like(velocity), tolerance), None
    refuse_out_of_range(velocity[::dim], delassus.diagonal()[::dim])
    mobility, speed = natural_units(delassus, velocity.reshape(contacts, dim))
    impulse = speed / mobility
    problem = scale_friction(
        delassus / mobility, velocity / speed, friction, step=unit_step(mobility)
    )
    _refuse_indefinite(problem, FIRST_LANCZOS_STEPS)
    closing, give = velocity[::dim], delassus.diagonal()[::dim]
    stuck = np.flatnonzero((closing < 0.0) & (give <= 0.0))
    if stuck.size:
        detail = (
            f"contact {stuck[0]} closes at {-closing[stuck[0]]:.3g} m/s and its normal mobility "
            f"is {give[stuck[0]]:.3g} 1/kg, so that no impulse stops it"
        )
        return Solution(np.zeros_like(velocity), Status.INFEASIBLE, detail=detail), None

    progress = Progress(problem, SAFETY * tolerance, callback, started)
    first = np.zeros((contacts, 3))
    if start is not None:
        first[:, :dim] = np.reshape(start, (contacts, dim))
        first = first / impulse / problem.reaction_unit
    with np.errstate(all="ignore"):  # overflow is never the best answer
        if not progress.note(first):
            run(problem, first, progress)

    best = progress.best if progress.best is not None else np.zeros_like(first)
    reaction = (best * problem.reaction_unit)[:, :dim].T
    # into the cone, unless that costs more accuracy elsewhere than it brings
    within = project_friction_cone(reaction, friction)
    solution = min(
        (
            _conclude(delassus, velocity, friction, impulse * answer.T.ravel(), tolerance, progress)
            for answer in (within, reaction)
        ),
        key=lambda solution: np.nan_to_num(solution.residuals[-1], nan=np.inf),
    )
    return solution, problem


def _rounding(delassus: csr_array, velocity: np.ndarray, solution: Solution, contacts: int) -> str:
    """Return a sentence with the level of rounding, if it limits the error."""
    terms = abs(delassus) @ np.abs(solution.value) + np.abs(velocity)
    rounding = np.finfo(float).eps * float(np.linalg.norm(terms))
    level = rounding / closing_norm(velocity.reshape(contacts, -1))
    if solution.residuals[-1] > ROUNDED * level:
        return ""
    return (
        f"rounding of W r + q is {level:.1e} of the closing velocities, and limits the error to "
        f"{solution.residuals[-1]:.1e}; raise the tolerance, or bring the masses nearer"
    )


def _softened(problem: ScaledFriction) -> str:
    """Return a sentence on compliance across the normals, if it helps, or on masses."""
    blocks = problem.blocks.copy()
    blocks[problem.diagonal[:, None], [1, 2], [1, 2]] += SOFTENING
    soft = replace(problem, blocks=blocks)
    progress = Progress(soft, SOFT_TOLERANCE)
    gauss_seidel(soft, np.zeros_like(soft.velocity), progress, SOFT_SWEEPS)
    if not progress.smallest <= progress.target:
        give = np.einsum("iaa->ia", problem.blocks[problem.diagonal])[:, 0]
        give = give / problem.reaction_unit[:, 0] * problem.velocity_unit[:, 0]
        mobile = np.flatnonzero(give > 0.0)
        heavy, light = (mobile[at(give[mobile])] for at in (np.argmin, np.argmax))
        if give[light] > CONTRAST * give[heavy]:
            return (
                f"mobilities along the normals differ by a factor of "
                f"{give[light] / give[heavy]:.1e}, most at contacts {heavy} and {light}; bring the "
                f"masses there nearer to each other, or lower the friction"
            )
        return (
            f"sweeps do not solve the problem with {SOFTENING:.0%} more mobility across the "
            f"normals either; lower the friction, or raise max_iterations"
        )
    return (
        f"friction makes the rigid problem non-monotone: with {SOFTENING:.0%} more mobility across "
        f"the normals sweeps solve it; give the contacts this compliance"
    )


def _checked(
    delassus: csr_array | np.ndarray, velocity: np.ndarray, friction: np.ndarray
) -> tuple[csr_array, np.ndarray, np.ndarray]:
    W = csr_array(delassus) if issparse(delassus) else np.asarray(delassus, dtype=float)
    q = np.asarray(velocity, dtype=float)
    mu = np.asarray(friction, dtype=float)
    if W.ndim != 2 or W.shape[0] != W.shape[1]:
        raise CaseError(f"delassus must be a square matrix, got shape {W.shape}")
    if q.shape != (W.shape[0],):
        raise CaseError(f"velocity must have shape ({W.shape[0]},) like delassus, got {q.shape}")
    if mu.ndim != 1 or q.size not in (2 * mu.size, 3 * mu.size):
        raise CaseError(
            f"friction must have an entry for every 2 or 3 of the {q.size} velocities, "
            f"got shape {mu.shape}"
        )
    for name, entries in (("delassus", W.data if issparse(W) else W), ("velocity", q)):
        if not np.all(np.isfinite(entries)):
            raise CaseError(f"{name} has entries that are NaN or infinite; check masses and units")
    wrong = np.flatnonzero(~((mu >= 0.0) & np.isfinite(mu)))
    if wrong.size:
        raise CaseError(
            f"friction must be finite and not negative, got {mu[wrong[0]]:g} at contact {wrong[0]}"
        )
    return csr_array(W), q, mu


def _refuse_indefinite(problem: ScaledFriction, steps: int) -> None:
    matrix = bsr_array((problem.blocks, problem.columns, problem.starts))
    half = 0.5 * matrix
    turned = half.T.tobsr()
    refuse_indefinite(
        lambda v: half @ v + turned @ v, matrix.shape[0], steps, INDEFINITE, width=3, rtol=NEGATIVE
    )


def _conclude(
    delassus: csr_array,
    velocity: np.ndarray,
    friction: np.ndarray,
    reaction: np.ndarray,
    tolerance: float,
    progress: Progress | None = None,
) -> Solution:
    verdict = verify_friction(delassus, velocity, friction, reaction, tolerance=tolerance)
    status = Status.STALLED
    if verdict.accepted:
        status = Status.CONVERGED
    elif not np.isfinite(verdict.residual):
        status = Status.NOT_FINITE
    if progress is None:
        return Solution(reaction, status, (verdict.residual,), (0.0,))
    residuals = (*progress.residuals, verdict.residual)
    seconds = (*progress.seconds, perf_counter() - progress.started)
    return Solution(reaction, status, residuals, seconds, tuple(progress.trail))

"""Structures in contact: the static problem (4)-(5) of the source for bodies of any bulk law."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from multiscale.convergence import Solution, Status, check_limits
from multiscale.errors import CaseError, ConvergenceError
from multiscale.macro.continuum.contact_newton import (
    ContactEquilibrium,
    condense_contact,
    newton_step,
    rest,
)
from multiscale.macro.continuum.finite_assembly import FiniteAssembly
from multiscale.numerics.newton import Limits, join_solutions, march

CUTS = 6  # limit of halvings of a load step
MAX_CONDENSED = 1500  # contact unknowns up to which a linear problem is condensed onto them


@dataclass(frozen=True)
class SurfaceState:
    """Traction (on bodies per deformed area), gap and slip of a contact, by nodes of side 1."""

    position: np.ndarray  # undeformed, shape (d, nodes), m
    frame: np.ndarray  # rows n (from side 1 to side 2), t1, t2, shape (nodes, d, d)
    traction: np.ndarray  # in that frame, shape (d, nodes), Pa
    gap: np.ndarray  # mean over the area of the node, m; NaN where nothing lies opposite
    area: np.ndarray  # of the node, weight of the traction, m² (m in two dimensions)
    slip: np.ndarray  # of side 2 against side 1 in this load step, (d - 1, nodes), m; or empty

    @property
    def pressure(self) -> np.ndarray:
        """Contact pressure, shape (nodes,), Pa, at least zero."""
        return np.asarray(-self.traction[0])

    @property
    def force(self) -> np.ndarray:
        """Force on side 2, shape (d,), N (N/m in two dimensions); opposite on side 1."""
        return np.asarray(-np.einsum("ka,aki,a->i", self.traction, self.frame, self.area))


@dataclass(frozen=True)
class ContactStep:
    """End of a load step; results are NaN if it did not converge."""

    time: float
    solution: Solution
    """Status of the solver, and its residuals; the value is the displacement of all bodies."""
    displacement: dict[str, np.ndarray]
    """By body, shape (d, nodes), m."""
    contact: dict[str, SurfaceState]
    """By contact."""
    state: dict[str, np.ndarray]
    """Internal variables by body, shape (n_state, elements, points)."""
    support_force: dict[str, np.ndarray]
    """Nodal forces of the supports on each body, shape (d, nodes), N."""

    def unwrap(self) -> "ContactStep":
        """Return the step, or raise if it did not converge."""
        self.solution.unwrap()
        return self


def solve_contact(
    assembly: FiniteAssembly,
    times: Sequence[float] = (1.0,),
    *,
    condensed: bool | None = None,
    max_iterations: int = 60,
    tolerance: float = 1e-9,
    callback: Callable[[float, int, float], None] | None = None,
) -> tuple[ContactStep, ...]:
    r"""Solve bodies in contact along a loading path.

    Parameters
    ----------
    times : sequence of float
        Ends of the load steps, increasing and positive; the path starts undeformed at zero.
        Friction and plasticity depend on the steps.
    condensed : bool, optional
        Whether to condense a linear problem onto its contact unknowns: the Delassus operator
        :math:`W = H^t K^{-1} H` by one factorisation. By default if it is possible and the contacts
        are few.
    max_iterations : int
        Iteration limit of a step. A step that fails is cut into halves.
    tolerance : float
        Bound on the residual forces and the error of the contact law, relative to the largest
        of load, reaction of the supports and contact force; dimensionless.
    callback : callable, optional, called as ``callback(time, iteration, residual)``

    Returns
    -------
    tuple of ContactStep
        Steps at all times, up to and including the first step that did not converge; see
        :meth:`ContactStep.unwrap`.

    Raises
    ------
    CaseError
        If the times do not increase from zero, a load is not finite, two surfaces have no
        common area, or ``condensed`` is True for a nonlinear problem.
    ConvergenceError
        If a body can move without force in the first step; a later step is then INFEASIBLE.

    Examples
    --------
    >>> from skfem import MeshQuad
    >>> from multiscale.laws.bulk import Elastic
    >>> from multiscale.macro import Body, Contact, FiniteAssembly, RigidPlane, solve_contact
    >>> mesh = MeshQuad().refined(2).with_defaults()
    >>> block = Body(mesh, Elastic(1e9, 0.0), supports={"top": (0.0, -1e-3)})
    >>> floor = RigidPlane((0.0, 0.0), (0.0, 1.0))
    >>> pair = FiniteAssembly({"block": block}, {"floor": Contact(("block", "bottom"), floor)})
    >>> step = solve_contact(pair)[-1].unwrap()
    >>> step.contact["floor"].pressure.round(3)
    array([1000000., 1000000., 1000000., 1000000., 1000000.])
    """
    check_limits(tolerance, max_iterations)
    times = [float(time) for time in times]
    if not times or not np.all(np.diff([0.0, *times]) > 0.0) or not np.isfinite(times[-1]):
        raise CaseError(f"times must increase from zero and be finite, got {times}")
    state = rest(assembly)
    for interface in assembly.interfaces:
        if not np.any(state.coupling.transmits[interface.rows, 0]):
            raise CaseError(
                f"contact {interface.name!r}: the surfaces {interface.contact.side1} and "
                f"{interface.contact.side2} have no common area; check positions and boundaries"
            )
    solve = _choose(assembly, state, condensed, Limits(max_iterations, tolerance), callback)

    steps: list[ContactStep] = []
    for time in times:
        try:
            solution, end = _march(solve, state, time)
        except ConvergenceError as error:
            if not steps:
                raise
            solution = Solution(state.displacement, Status.INFEASIBLE, detail=str(error))
            end = replace(state, time=time)
        steps.append(_report(assembly, solution, end))
        if not solution.converged:
            break
        state = end
    return tuple(steps)


Solve = Callable[[ContactEquilibrium, float], tuple[Solution, ContactEquilibrium]]


def _choose(
    assembly: FiniteAssembly,
    state: ContactEquilibrium,
    condensed: bool | None,
    limits: Limits,
    callback: Callable[[float, int, float], None] | None,
) -> Solve:
    def at(time: float) -> Limits:
        return replace(limits, callback=callback and partial(callback, time))

    if condensed and not assembly.is_linear:
        raise CaseError(
            "only a linear problem can be condensed: small strain and small sliding; "
            "leave out condensed=True"
        )
    few = state.reaction.size <= MAX_CONDENSED
    if assembly.is_linear and (condensed or (condensed is None and few)):
        model = condense_contact(assembly, state)
        if model is not None:
            return lambda before, time: model.step(before, time, at(time))
        if condensed:
            raise CaseError(
                "a body is supported only by contacts, so the problem cannot be condensed; "
                "leave out condensed=True or add supports"
            )
    return lambda before, time: newton_step(assembly, before, time, at(time))


def _march(
    solve: Solve, before: ContactEquilibrium, time: float
) -> tuple[Solution, ContactEquilibrium]:
    substeps = march(solve, before, (before.time, time), CUTS)
    # the slip of a load step is the sum over its substeps
    slips = (substep.state.jump[:, 1:] for substep in substeps if substep.solution.converged)
    slip = sum(slips, start=np.zeros_like(before.jump[:, 1:]))
    trail = [
        f"step to {substep.aim:g}: {substep.solution.status.name.lower()}" for substep in substeps
    ]
    end = substeps[-1].state
    whole = join_solutions([substep.solution for substep in substeps], trail)
    return whole, replace(end, jump=np.hstack([end.jump[:, :1], slip]))


def _report(assembly: FiniteAssembly, solution: Solution, end: ContactEquilibrium) -> ContactStep:
    """Split a state into bodies and contacts; NaN unless it converged."""
    d, c = assembly.start.shape[1], assembly.components
    known = 1.0 if solution.converged else np.nan
    contact = {}
    for interface in assembly.interfaces:
        rows = interface.rows
        coupling = end.coupling[rows]
        traction = np.full((d, len(coupling.area)), 0.0 * known)
        traction[:c] = -known * end.reaction[rows].T
        jump = known * np.where(coupling.transmits[:, :1], end.jump[rows], np.nan)
        place = assembly.start[interface.nodes[0]].T
        contact[interface.name] = SurfaceState(
            place, coupling.frame, traction, jump[:, 0], coupling.area, jump[:, 1:].T
        )

    def of_bodies(values: np.ndarray) -> dict[str, np.ndarray]:
        return {
            name: known * values[assembly.unknowns(k)].reshape(-1, d).T
            for k, name in enumerate(assembly.bodies)
        }

    return ContactStep(
        end.time,
        solution,
        of_bodies(end.displacement),
        contact,
        dict(zip(assembly.bodies, end.state, strict=True)),
        of_bodies(np.where(assembly.free, 0.0, end.unbalance)),
    )

"""Two elastic blocks pressed together through a rough interface."""

from collections.abc import Mapping, Sequence
from time import perf_counter

import numpy as np

from multiscale.convergence import check_limits
from multiscale.errors import CaseError, MultiscaleError
from multiscale.laws import HystereticLaw
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.data_range import data_ends, load_shares, with_load_shares
from multiscale.macro.joint.geometry import RoughJoint
from multiscale.macro.joint.joint_assembly import CondensedJoint, condense_joint
from multiscale.macro.monolithic import InterfaceSolution, solve_interface
from multiscale.schema import MACRO_RESULT, Dataset

__all__ = ["check_preloads", "joint_result", "ratios", "rough_joint"]


def rough_joint(
    joint: RoughJoint,
    law: InterfaceLaw,
    preloads: np.ndarray,
    *,
    samples: Sequence[InterfaceLaw] = (),
    extrapolate: bool = False,
    max_iterations: int = 100,
    tolerance: float = 1e-10,
) -> Dataset:
    r"""Press the joint and return its normal stiffness at every preload.

    Parameters
    ----------
    joint : RoughJoint, geometry, elasticity and mesh
    law : InterfaceLaw
        Frictionless normal law; its tangential part is not used. One with an unloading branch is
        loaded for the first time.
    preloads : ndarray, shape (steps,)
        Nominal pressures :math:`p > 0`, Pa: force over section. Each step starts from the one
        before.
    samples : sequence of InterfaceLaw
        Bootstrap samples of the law; each gives one row of ``joint_stiffness_sample``.
    extrapolate : bool
        Whether steps far outside the data of the law keep what it extrapolates; see
        :func:`~multiscale.macro.data_range.with_load_shares`.
    max_iterations : int, iteration limit of a step
    tolerance : float
        Bound on the forces out of balance in (2) and (3), see
        :func:`~multiscale.macro.monolithic.solve_interface`; dimensionless.

    Returns
    -------
    Dataset
        Follows ``MACRO_RESULT``. The stiffness is the consistent tangent
        :math:`\mathrm{d}p / \mathrm{d}a`, Pa/m, with the approach :math:`a` of the platen where
        the force acts; ``interface_stiffness`` is the area mean of the tangent of the law, and
        ``solid_stiffness`` belongs to the same blocks without a jump between them. A step that
        failed is NaN with ``converged`` 0, one far outside the data of the law is NaN with
        ``known`` 0; a sample that failed is NaN. A law with an unloading
        branch also gives ``unloading_stiffness``, under a preload which begins to fall and
        comes back.

    Raises
    ------
    CaseError
        If a preload is not positive.

    Notes
    -----
    The blocks are condensed once onto the normal jump :math:`j` of the interface. With the
    compliance :math:`C = C_1 + C_2` of both blocks for nodal forces :math:`\lambda` on their
    faces, and the rigid motion :math:`w` of the platen,

    .. math::
        j &= R w + C \lambda, \tag{1} \\
        \lambda &= N^T (\omega\, p(N j)), \tag{2} \\
        R^T \lambda &= \ell P, \tag{3}

    where :math:`N` interpolates to the quadrature points, :math:`\omega` are their weights and
    :math:`\ell` is the motion that the force :math:`P` works on. Jump and elastic displacement
    are unknowns of their own: neither is the small difference of large numbers, however stiff
    the law or the blocks. The monolithic form of the same problem is the assembly
    :func:`pressed_blocks`.
    """
    check_limits(tolerance, max_iterations)
    preloads = check_preloads(preloads)
    model = condense_joint(joint, law)
    names = (*ratios(law), "interface_stiffness", "approach", "mean_gap", "closed_fraction")
    values = {name: np.full(preloads.size, np.nan) for name in (*names, "residual", "wall_time")}
    values["converged"] = np.zeros(preloads.size, dtype=int)
    pressure = np.full((preloads.size, model.weight.size), np.nan)
    solutions: list[InterfaceSolution | None] = []

    def solve(
        law: InterfaceLaw, preload: float, near: InterfaceSolution | None
    ) -> InterfaceSolution:
        """Solve (1)-(3), maybe from another solution."""
        return solve_interface(
            model.stiffness,
            preload * model.load,
            model.jump,
            model.weight,
            law.normal_law,
            start=None if near is None else near.value,
            jump=None if near is None else near.jump,
            flexible=model,
            max_iterations=max_iterations,
            tolerance=tolerance,
        )

    for step, preload in enumerate(preloads):
        before = perf_counter()
        solution = solve(law, preload, solutions[-1] if solutions else None)
        solutions.append(solution if solution.converged else None)
        values["converged"][step] = solution.converged
        values["residual"][step] = solution.residuals[-1]
        if solution.converged:
            jump = solution.jump[0]
            pressure[step] = _respond(law, solution.jump)[0]
            found = _stiffness(model, law, solution.jump) | {
                "approach": model.approach(solution.value),
                "mean_gap": float(model.weight @ jump) / model.area + law.gap,
                "closed_fraction": float(model.weight @ (pressure[step] > 0.0)) / model.area,
            }
            for name, value in found.items():
                values[name][step] = value
        values["wall_time"][step] = perf_counter() - before

    rows = []
    for sample in samples:  # each step starts from the law's own
        failed = dict.fromkeys(("interface_stiffness", *ratios(sample)), np.nan)
        steps = []
        for preload, start in zip(preloads, solutions, strict=True):
            solution = solve(sample, preload, start)
            good = solution.converged
            steps.append(_stiffness(model, sample, solution.jump) if good else failed)
        rows.append({name: np.array([step[name] for step in steps]) for name in failed})
    data = data_ends(law)
    shares = load_shares(pressure, model.weight, data)
    result = {"preload": preloads, **values}
    return joint_result(result, rows, model.solid_stiffness, shares, data, extrapolate=extrapolate)


def _respond(law: InterfaceLaw, jump: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pressure (Pa) and stiffness (Pa/m) of the law for normal jumps, shape (1, points), m."""
    response = law.normal_law.respond(jump, np.zeros((law.normal_law.n_state, jump.size)))
    return -response.traction[0], response.tangent[0, 0]


def joint_result(
    values: Mapping[str, np.ndarray],
    rows: Sequence[Mapping[str, np.ndarray]],
    solid_stiffness: float,
    shares: np.ndarray,
    data: tuple[float, float, float],
    *,
    extrapolate: bool,
) -> Dataset:
    """Dataset after ``MACRO_RESULT`` of what the law and each of its samples give at the preloads.

    Shares of the load lie outside the data of the law, shape (3, steps) and Pa; see
    :func:`~multiscale.macro.data_range.with_load_shares`.
    """
    names = rows[0] if rows else ()
    samples = {f"{name}_sample": np.array([row[name] for row in rows]) for name in names}
    found = with_load_shares(
        MACRO_RESULT.build({**values, **samples}),
        shares[..., None],
        np.array([data]),
        extrapolate=extrapolate,
    )
    solid = np.full(values["preload"].size, solid_stiffness)  # no law enters it
    return MACRO_RESULT.assign(found, {"solid_stiffness": solid})


def _stiffness(model: CondensedJoint, law: InterfaceLaw, jump: np.ndarray) -> dict[str, float]:
    """Stiffness of the interface, and of the joint on every branch of its law, Pa/m.

    The stiffness of the law is multiplied by a ratio: unloading over loading, for a preload that
    begins to fall.
    """
    K = model.weight * _respond(law, jump)[1]
    found = {"interface_stiffness": float(K.sum()) / model.area}
    for name, ratio in ratios(law).items():
        try:
            change = model.direction(model.jump, ratio * K[None, None], model.load)
            found[name] = 1.0 / model.approach(change)
        except MultiscaleError:
            found[name] = np.nan
    return found


def check_preloads(preloads: np.ndarray) -> np.ndarray:
    """Refuse preloads that press nothing."""
    given = np.asarray(preloads, dtype=float)
    if not np.all((given > 0.0) & np.isfinite(given)):
        raise CaseError(f"preloads must be positive and finite (Pa), got {given}")
    return given


def ratios(law: InterfaceLaw) -> dict[str, float]:
    """Stiffness of the law on its branches, over its stiffness in loading."""
    if isinstance(law, HystereticLaw):
        return {"joint_stiffness": 1.0, "unloading_stiffness": law.stiffness_ratio}
    return {"joint_stiffness": 1.0}

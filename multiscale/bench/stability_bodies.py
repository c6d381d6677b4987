"""Stiff and extreme bodies with joints, each with a residual verified in the answer only."""

from typing import TYPE_CHECKING, cast

import numpy as np

from multiscale.bench.stability_links import method_of, refuse_failure
from multiscale.schema import Dataset

if TYPE_CHECKING:
    from collections.abc import Iterable

    from multiscale.laws import Sliders
    from multiscale.macro import Assembly
    from multiscale.macro.monolithic import Assembled

YOUNG, POISSON = 210e9, 0.3  # Pa, 1
EDGE, PRESSURE = 0.02, 20e6  # of blocks, m, and on them, Pa


def joint(law_over_block: float, friction: float, parts: int, method: str = "LATIN") -> float:
    """Cycle two blocks with a rough joint: distance of all steps from bodies and law."""
    from multiscale.laws.bulk import Elastic
    from multiscale.macro.bodies import stacked_blocks
    from multiscale.macro.substructures import joint_path, load_joint

    blocks = stacked_blocks(
        (EDGE,) * 3, (2, 2, 2), [Elastic(YOUNG, POISSON)] * 2, [_bed(law_over_block, friction)]
    )
    shear = min(0.5 * friction, 0.3) * PRESSURE  # a half would tip the upper block
    loading = joint_path((PRESSURE,), shear=shear, cycles=1, steps=2)
    cut = load_joint(blocks, loading, method=method_of(method, parts))
    return _fault_of_path(blocks, loading.factors(), cut, law_over_block, parts)


def joint_path(scene: str, law_over_block: float, friction: float, method: str) -> float:
    """Load blocks that match or not, and open, slip or slide away: distance as of ``joint``."""
    from multiscale.fe.mesh_file import box_mesh
    from multiscale.laws.bulk import Elastic
    from multiscale.macro import Assembly, Body, Interface, solve_assembly

    tilt, shear = (1.5, 0.1) if scene == "opens" else (0.0, 0.5)
    if scene == "slides away":
        shear = 1.1
    steel, elements = Elastic(YOUNG, POISSON), (3, 2, 1) if scene == "does not match" else (2, 2, 2)
    lower = Body(box_mesh((EDGE,) * 3, (2, 2, 2)), steel, supports={"bottom": (0.0, 0.0, 0.0)})
    upper = Body(
        box_mesh((EDGE,) * 3, elements, origin=(0.0, 0.0, EDGE)),
        steel,
        supports={"front": (None, 0.0, None)},
        tractions={
            "top": (
                lambda x, t: PRESSURE * min(friction, 0.4) * shear * (t == 1.0),
                0.0,
                lambda x, t: -PRESSURE * (1.0 + tilt * (2.0 * x[0] / EDGE - 1.0)) * (t == 0.0),
            )
        },
    )
    face = Interface((0, 1), ("top", "bottom"), _bed(law_over_block, friction))
    blocks = Assembly((lower, upper), (face,), (0.0, 1.0))
    factors = np.array([[1.0, 0.0], [1.0, 0.5], [1.0, 1.0], [0.6, 0.5], [1.0, -1.0]])
    cut = solve_assembly(blocks, factors, method=method_of(method, 1))
    return _fault_of_path(blocks, factors, cut, law_over_block, 1)


def large_blocks(
    law_over_block: float, friction: float, elements: int, *, matching: bool = True
) -> "Assembly":
    """Two blocks of a number of elements along an edge, pressed, then sheared, by load cases."""
    from multiscale.fe.mesh_file import box_mesh
    from multiscale.laws.bulk import Elastic
    from multiscale.macro import Assembly, Body, Interface

    steel, coarse = Elastic(YOUNG, POISSON), elements if matching else elements - 2
    shear = min(0.5 * friction, 0.3) * PRESSURE
    load = {"top": (lambda x, t: shear * t, 0.0, lambda x, t: PRESSURE * (t - 1.0))}
    lower, upper = (
        Body(
            box_mesh((EDGE, EDGE, 0.5 * EDGE), (count, count, count // 2), origin=(0.0, 0.0, z)),
            steel,
            supports={"bottom": (0.0, 0.0, 0.0)} if z == 0.0 else {"front": (None, 0.0, None)},
            tractions={} if z == 0.0 else load,
        )
        for z, count in ((0.0, elements), (0.5 * EDGE, coarse))
    )
    face = Interface((0, 1), ("top", "bottom"), _bed(law_over_block, friction))
    return Assembly((lower, upper), (face,), (0.0, 1.0))


def large_bodies(law_over_block: float, friction: float, matching: str) -> float:
    """Press and shear blocks of 2000 unknowns or more by multigrid: distance as of ``joint``."""
    from multiscale.macro import MultigridNewton, solve_assembly

    blocks = large_blocks(law_over_block, friction, 9, matching=matching == "yes")
    factors = np.array([[1.0, 0.0], [1.0, 1.0], [1.0, -1.0]])
    result = solve_assembly(blocks, factors, method=MultigridNewton())
    return _fault_of_path(blocks, factors, result, law_over_block, 1)


def bolts(pull: float, law_over_block: float, method: str) -> float:
    """Pull bolted blocks and release them: errors of the balance and of the initial state."""
    from multiscale.fe.mesh_file import box_mesh
    from multiscale.laws.bulk import Elastic
    from multiscale.macro import Assembly, Body, Bolt, Interface, solve_assembly

    steel, supports = Elastic(YOUNG, 0.0), {"left": (0.0, None, None), "front": (None, 0.0, None)}
    corners = [(0.0, 0.0, 0.0), (0.0, EDGE, 0.0), (EDGE, 0.0, 0.0)]
    lower, upper = (
        Body(
            box_mesh((EDGE,) * 3, (2, 2, 2), origin=(0.0, 0.0, bottom)),
            steel,
            supports=supports,
            tractions={face: (0.0, 0.0, sign * PRESSURE)},
            pins={} if bottom else dict.fromkeys(corners, (None, None, 0.0)),
        )
        for bottom, face, sign in ((-EDGE, "bottom", -1.0), (0.0, "top", 1.0))
    )
    preload = PRESSURE * EDGE**2
    bolt = Bolt((1, 0), ("top", "bottom"), 0.1 * YOUNG * EDGE, preload)
    face = Interface((0, 1), ("top", "bottom"), _bed(law_over_block, 0.2))
    blocks = Assembly((lower, upper), (face,), bolts=(bolt,))
    pulls = pull * np.array([0.0, 0.5, 1.0, 0.5, 0.0])
    path = np.stack([np.ones(5), pulls], axis=1)
    result = solve_assembly(blocks, path, method=method_of(method, 1))
    refuse_failure(result)
    carried = result["bolt_force"].values[:, 0] / preload
    clamp = -result["traction"].values[..., 0] @ result["point_area"].values / preload
    faults = [carried - clamp - pulls, carried - carried[::-1]]
    return float(np.abs(faults).max())


def _bed(law_over_block: float, friction: float) -> "Sliders":
    """Return a law with a multiple of the stiffness of a block at the pressure."""
    from multiscale.laws import Exponential, Sliders

    decay = PRESSURE * EDGE / (law_over_block * YOUNG)  # K = p / decay
    normal = Exponential(10.0 * PRESSURE, decay)
    return Sliders(normal, friction, pressures=(0.1 * PRESSURE, 10.0 * PRESSURE))


def _fault_of_path(
    blocks: "Assembly", factors: np.ndarray, result: Dataset, law_over_block: float, parts: int
) -> float:
    """Return the largest fault of the steps of a path, over the pressure; refuse a failed path."""
    from multiscale.macro.substructures import assemble, cut_assembly

    refuse_failure(result)
    cut = (parts, parts) if result.attrs["substructures"] > len(blocks.bodies) else (1, 1)
    steps = (factors, result["jump"].values, result["traction"].values)
    series = YOUNG / EDGE / (1.0 / law_over_block + 1.0)  # of law and bodies, Pa/m
    whole = assemble(cut_assembly(blocks, cut))
    law = cast("Sliders", blocks.interfaces[0].law)
    return _joint_faults(whole, law, zip(*steps, strict=True), series) / PRESSURE


def _joint_faults(
    whole: "Assembled",
    law: "Sliders",
    steps: "Iterable[tuple[np.ndarray, np.ndarray, np.ndarray]]",
    stiffness: float,
) -> float:
    """Measure the distance of tractions and jumps from bodies and law, as backward errors."""
    from scipy.sparse import csr_array, diags_array

    from multiscale.numerics.factorisation import factorise

    B, weight = whole.jump, np.tile(whole.weight, 3)
    solve = factorise(csr_array(whole.stiffness + stiffness * (B.T @ diags_array(weight) @ B)))
    state = np.zeros((law.n_state, whole.weight.size))
    before, faults = np.zeros((3, whole.weight.size)), []
    for factor, jump, traction in steps:
        y, t = jump.T, traction.T
        # the jumps of the bodies under the tractions, (K + k B^T w B) u = f + B^T w (k y - t): they
        # are B u under the tractions t + k (B u - y), and k |B u - y| is the error of both
        u = solve(whole.load @ factor + B.T @ (weight * (stiffness * y - t).ravel()))
        faults.append(stiffness * np.abs((B @ u).reshape(y.shape) - y).max())

        # the tractions of the law, by ``respond``, at the jumps within the rounding that the
        # resolvent gives as the nearest
        moved = y - before  # a bed depends on the change of the tangential jumps only
        moved[0] = y[0]
        rounding = 4.0 * np.finfo(float).eps * np.maximum(np.abs(y), np.abs(before))
        nearest = law.resolvent(t + stiffness * moved, stiffness, state) - moved
        response = law.respond(moved + np.clip(nearest, -rounding, rounding), state)
        faults.append(np.abs(response.traction - t).max())
        state, before = law.from_here(response.state), y
    return float(np.max(faults))

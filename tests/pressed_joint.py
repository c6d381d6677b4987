"""Two blocks under their platen, by the solver of assemblies."""

from types import SimpleNamespace

import numpy as np

from multiscale.macro import pressed_blocks
from multiscale.macro.monolithic import soften_tangent
from multiscale.macro.substructures import assemble, cut_assembly


def press_blocks(joint, law, preloads, **options):
    """Press a joint: approach, mean gap, closed fraction and stiffness at every preload.

    The stiffness is the consistent tangent dp/da, Pa/m. A step that failed is NaN.
    """
    whole = assemble(cut_assembly(pressed_blocks(joint, law)))
    load, weight, area = whole.load[:, 0], whole.weight, joint.area
    flexible, both = whole.flexible, whole.flexible.split(load, motions=False)
    result = SimpleNamespace(
        **{
            name: np.full(len(preloads), np.nan)
            for name in ("approach", "mean_gap", "closed_fraction", "joint_stiffness", "residual")
        },
        converged=np.zeros(len(preloads), dtype=bool),
        pressure=np.full((len(preloads), weight.size), np.nan),
        weight=weight,
    )
    near = {}
    for step, preload in enumerate(preloads):
        solution = whole.solve(law, np.array([preload]), **near, **options)
        near = {}
        result.converged[step] = solution.converged
        result.residual[step] = solution.residuals[-1]
        if not solution.converged:
            continue
        near = {"start": solution.value, "jump": solution.jump}
        response = law.respond(solution.jump, np.zeros((law.n_state, weight.size)))
        result.pressure[step] = -response.traction[0]
        result.approach[step] = load @ solution.value / area
        result.mean_gap[step] = weight @ solution.jump[0] / area + law.gap
        result.closed_fraction[step] = weight @ (response.traction[0] < 0.0) / area
        tangent = weight * soften_tangent(response, flexible.resistance).tangent
        moved = flexible.direction(tangent, both)
        result.joint_stiffness[step] = area / (both @ moved)
    return result

"""Blocks of elements under a platen, also off its centre, by the solver of assemblies."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from multiscale.fe.mesh_file import box_mesh
from multiscale.macro import Assembly, Body, Interface, Platen, RoughJoint
from multiscale.macro.monolithic import soften_tangent
from multiscale.macro.substructures import assemble, cut_assembly


@dataclass(frozen=True)
class ElementJoint(RoughJoint):
    """A joint with a mesh, and the place of its force along x and y, m; guided without it."""

    elements: tuple[int, int] = (6, 6)
    layers: tuple[int, int] = (4, 4)  # of elements of the lower and the upper block
    eccentricity: tuple[float, float] | None = None
    element: object = None
    quadrature_order: int = 3


def pressed_blocks(joint, law):
    """Press the upper block on the lower one by a frictionless rigid platen, by 1 Pa.

    Each block is held across z at two corners on its platen, so that an even pressure gives
    uniaxial stress.
    """
    (x, y), area = (0.5 * length for length in joint.section), joint.area
    bodies = []
    for block, layers, base, plate, supports in (
        (joint.lower, joint.layers[0], *2 * [-joint.lower.height], {"bottom": (None, None, 0.0)}),
        (joint.upper, joint.layers[1], 0.0, joint.upper.height, {}),
    ):
        size, count = (*joint.section, block.height), (*joint.elements, layers)
        mesh = box_mesh(size, count, origin=(-x, -y, base))
        pins = {(-x, -y, plate): (0.0, 0.0, None), (x, -y, plate): (None, 0.0, None)}
        bodies.append(Body(mesh, block.law, supports, element=joint.element, pins=pins))
    point = None if joint.eccentricity is None else (*joint.eccentricity, joint.upper.height)
    interface = Interface((0, 1), ("top", "bottom"), law, joint.quadrature_order)
    return Assembly(tuple(bodies), (interface,), platens=(Platen(1, "top", -area, point),))


def press_blocks(joint, law, preloads, **options):
    """Press a joint: approach, mean gap, closed fraction and stiffness at every preload.

    The stiffness is the consistent tangent dp/da, Pa/m. A step that failed is NaN.
    """
    whole = assemble(cut_assembly(pressed_blocks(joint, law)))
    load, weight, area = whole.load[:, 0], whole.weight, joint.area
    flexible = whole.flexible  # of a small joint
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
        if flexible is None:
            moved = whole.linear(whole.stiffness, whole.jump, weight * response.tangent)(load)
            result.joint_stiffness[step] = area / (load @ moved)
            continue
        tangent = weight * soften_tangent(response, flexible.resistance).tangent
        both = flexible.split(load, motions=False)
        result.joint_stiffness[step] = area / (both @ flexible.direction(tangent, both))
    return result

"""Interfaces between faces with meshes that do not match: averages over the nodes of one side."""

from dataclasses import replace

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import (
    AssembledNewton,
    Assembly,
    Body,
    Interface,
    LatinMethod,
    NewtonSchur,
    solve_assembly,
)
from multiscale.macro.substructures import cut_assembly

EDGE, NORMAL = 0.02, Exponential(1e9, 0.2e-6)
LAW = Sliders(NORMAL, 0.3, pressures=(1e6, 1e8), slabs=8)
METHODS = [AssembledNewton, LatinMethod, NewtonSchur]
HELD = {"bottom": (0.0, 0.0, 0.0)}


def blocks(below, above, *, top, sides=0.0, nu=0.3, size=EDGE, law=LAW):
    """A clamped block and a block on it with other elements, under tractions on top and sides."""
    lower = Body(box_mesh((EDGE,) * 3, below), Elastic(210e9, nu), supports=HELD)
    pulled = {name: (0.0, 0.0, way * sides) for name, way in (("left", -1.0), ("right", 1.0))}
    upper = Body(
        box_mesh((size, size, EDGE), above, origin=(0.0, 0.0, EDGE)),
        Elastic(210e9, nu),
        tractions={"top": top, **pulled},
    )
    lower = replace(lower, tractions=pulled)
    return Assembly((lower, upper), (Interface((0, 1), ("top", "bottom"), law),))


@pytest.mark.parametrize(
    "elements", [((2, 2, 1), (3, 3, 2)), ((5, 3, 1), (2, 4, 1)), ((7, 5, 1), (2, 2, 1))]
)
def test_even_pressure_and_even_shear_pass_the_patch_test(elements):
    pressure, shear = 20e6, 3e6
    result = solve_assembly(
        blocks(*elements, top=(shear, 0.0, -pressure), sides=shear, nu=0.0), [0.4, 1.0]
    )
    assert result.converged.values.all()
    traction, jump = result.traction.values[1], result.jump.values[1]
    np.testing.assert_allclose(traction[:, 0], -pressure, rtol=1e-9)
    np.testing.assert_allclose(np.hypot(*traction[:, 1:].T), shear, rtol=1e-9)
    np.testing.assert_allclose(jump, np.tile(jump[0], (len(jump), 1)), atol=1e-9 * abs(jump).max())
    np.testing.assert_allclose(result.point_area.sum(), EDGE**2, rtol=1e-12)
    # stress is even in both blocks: the displacement is linear in the height
    strain = np.array([shear * 2.0 / 210e9, 0.0, -pressure / 210e9])
    rest = result.displacement.values[1] - np.outer(result.position.values[:, 2], strain)
    for body in np.split(rest, [np.prod(np.add(elements[0], 1))]):
        np.testing.assert_allclose(body, np.tile(body[0], (len(body), 1)), atol=1e-14)


@pytest.mark.parametrize("sides", [(0, 1), (1, 0)])
def test_a_small_block_on_one_large_facet_rests_on_its_corners(sides):
    """The points have the area and the second moments of the block, whatever the order of sides."""
    ground = Body(box_mesh((EDGE, EDGE, EDGE), (2, 2, 1)), Elastic(210e9, 0.3), supports=HELD)
    edge, n, corner = 0.2 * EDGE, 4, 0.25 * EDGE
    small = box_mesh((edge,) * 3, (n,) * 3, origin=(corner, corner, EDGE))
    block = Body(small, Elastic(210e9, 0.3), tractions={"top": (0.0, 0.0, -1e6)})
    faces = np.array(["top", "bottom"])[list(sides)]
    joint = Interface(sides, tuple(faces.tolist()), LAW)
    result = solve_assembly(Assembly((ground, block), (joint,)))
    area, x = result.point_area.values, result.point_position.values[:, 0] - corner - 0.5 * edge
    np.testing.assert_allclose([area.sum(), area @ x], [edge**2, 0.0], atol=1e-9 * edge**2)
    # the areas of corners approximate the trapezoidal rule, at their centroids
    assert area @ x**2 == pytest.approx(edge**4 / 12.0, rel=1.0 / n)


def tilted(position, time):
    """Pressure that grows along x."""
    return -time * 20e6 * (0.5 + position[0] / EDGE)


def test_it_converges_to_what_matching_meshes_give():
    def lowered(below, above):
        result = solve_assembly(blocks((below,) * 3, (above,) * 3, top=(0.0, 0.0, tilted)))
        top = np.isclose(result.position.values[:, 2], 2.0 * EDGE)
        x, moved = result.position.values[top, 0], result.displacement.values[0, top, 2]
        return np.polyfit(x, moved, 1) @ [EDGE, 1.0]  # at the side that is pressed more

    exact = lowered(9, 9)
    errors = [abs(lowered(n, m) / exact - 1.0) for n, m in ((2, 3), (4, 6))]
    matching = [abs(lowered(n, n) / exact - 1.0) for n in (2, 4)]
    assert errors[1] < 0.4 * errors[0]
    assert all(mine < theirs for mine, theirs in zip(errors, matching, strict=True))


@pytest.mark.parametrize("method", METHODS[1:])
def test_every_method_finds_the_same_and_a_cut_changes_little(method):
    assembly = blocks((4, 2, 1), (6, 3, 1), top=(2e6, 0.0, tilted))
    steps = [0.5, 1.0]
    once, cut, computed = (
        solve_assembly(assembly, steps, method=entry)
        for entry in (AssembledNewton(), AssembledNewton(parts=(2, 1)), method(parts=(2, 1)))
    )
    assert computed.converged.values.all()
    size = float(abs(once.displacement).max())
    np.testing.assert_allclose(computed.displacement, cut.displacement, atol=1e-6 * size)
    # averages end at the cut, so that it counts as a change of the mesh
    np.testing.assert_allclose(cut.displacement, once.displacement, atol=2e-3 * size)
    for axis in range(3):
        forces = [item.traction[..., axis] @ item.point_area for item in (once, cut)]
        np.testing.assert_allclose(*forces, atol=1e-9 * 20e6 * EDGE**2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shift": (0.0, 0.0, 1e-4)}, "do not touch face to face: their nodes are 0.0001 m apart"),
        ({"scale": 1e3}, "a mesh in mm may have been read as m"),
        ({"shift": (0.7 * EDGE, 0.0, 0.0)}, "overlap on 0.3 of the smaller face, and at least 0.5"),
        ({"face": "top"}, "do not touch face to face"),
        ({"held": True}, "interface 0 lies on a support: all nodes of the boundary 'bottom' of"),
        ({"order": 2}, "with the same elements, or leave out quadrature_order"),
    ],
)
def test_faces_that_no_law_can_join_are_refused(change, message):
    assembly = blocks((2, 2, 1), (3, 3, 1), top=(0.0, 0.0, -1e6))
    lower, upper = assembly.bodies
    shift = np.reshape(change.get("shift", (0.0, 0.0, 0.0)), (3, 1))
    mesh = upper.mesh.translated(shift.ravel()).scaled(change.get("scale", 1.0))
    upper = replace(
        upper, mesh=mesh, supports={"bottom": (0.0, 0.0, 0.0)} if "held" in change else {}
    )
    names = ("top", change.get("face", "bottom"))
    interface = Interface((0, 1), names, LAW, change.get("order"))
    with pytest.raises(CaseError, match=message):
        cut_assembly(Assembly((lower, upper), (interface,)))


def test_plates_that_lap_in_part_name_the_part():
    assembly = blocks((4, 2, 1), (3, 3, 1), top=(0.0, 0.0, -1e6), size=0.75 * EDGE)
    lower, upper = assembly.bodies
    moved = upper.mesh.translated((0.7 * EDGE, 0.0, 0.0))
    far = replace(assembly, bodies=(lower, replace(upper, mesh=moved)))
    with pytest.raises(CaseError, match="name the regions where the faces meet"):
        cut_assembly(far)
    lap = lower.mesh.with_boundaries(
        {"lap": lambda x: np.isclose(x[2], EDGE) & (x[0] > 0.75 * EDGE)}
    )
    named = Interface((0, 1), ("lap", "bottom"), LAW)
    problem = cut_assembly(
        replace(far, bodies=(replace(lower, mesh=lap), far.bodies[1]), interfaces=(named,))
    )
    (joint,) = problem.joints
    np.testing.assert_allclose(joint.weight.sum(), 0.25 * 0.75 * EDGE**2, rtol=1e-9)

"""Interfaces of elements of second order: averages about the corners of side 2."""

import numpy as np
import pytest
from skfem import ElementHexS2, MeshHex, MeshTet

from multiscale.fe.elasticity import element_of_order
from multiscale.laws import Exponential, RigidContact, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import (
    AssembledNewton,
    Assembly,
    Body,
    GapMap,
    Interface,
    LatinMethod,
    NewtonSchur,
    solve_assembly,
)
from multiscale.macro.bodies.assembly import GROUND
from multiscale.macro.substructures import cut_assembly
from tests.closed_forms import hertz
from tests.contact_scenes import block, graded, moment_radius, near

EDGE = 0.02
LAW = Sliders(Exponential(1e9, 0.2e-6), 0.3, pressures=(1e6, 1e8), slabs=8)
FEW, MORE = (2, 2, 1), (3, 3, 2)


def sheared_blocks(kinds, orders, elements):
    """Two blocks on each other under even pressure and even shear, and these stresses, Pa."""
    pressure, shear, bodies = 20e6, 3e6, []
    sides = {name: (0.0, 0.0, way * shear) for name, way in (("left", -1.0), ("right", 1.0))}
    top = {"top": (shear, 0.0, -pressure)}
    fixed = {"bottom": (0.0, 0.0, 0.0)}
    for k, (kind, order, count) in enumerate(zip(kinds, orders, elements, strict=True)):
        mesh = block(kind, count, (0.0, 0.0, k * EDGE), (EDGE, EDGE, (k + 1) * EDGE))
        element = ElementHexS2() if order == "serendipity" else element_of_order(mesh, order)
        loads = sides | (top if k else {})
        bodies.append(Body(mesh, Elastic(210e9, 0.0), {} if k else fixed, loads, element))
    return Assembly(bodies, (Interface((0, 1), ("top", "bottom"), LAW),)), pressure, shear


@pytest.mark.parametrize(
    ("kinds", "orders", "elements", "method"),
    [
        pytest.param("tt", (2, 2), (FEW, FEW), AssembledNewton(), id="matching"),
        pytest.param("tt", (2, 2), (FEW, FEW), LatinMethod((2, 1)), id="matching, cut"),
        pytest.param("tt", (2, 2), (FEW, MORE), AssembledNewton(), id="not matching"),
        pytest.param("tt", (2, 2), (MORE, FEW), LatinMethod(), id="not matching, LATIN"),
        pytest.param("hh", (2, 2), (FEW, MORE), NewtonSchur((2, 1)), id="nine nodes"),
        pytest.param("hh", ("serendipity",) * 2, (FEW, MORE), AssembledNewton(), id="eight nodes"),
        pytest.param("hh", ("serendipity",) * 2, (FEW, FEW), AssembledNewton(), id="eight, alike"),
        pytest.param("hh", (2, 2), (FEW, FEW), AssembledNewton(), id="nine, alike"),
        pytest.param("th", (1, 2), (FEW, MORE), AssembledNewton(), id="first below"),
        pytest.param("ht", (2, 1), (FEW, FEW), LatinMethod(), id="first above"),
    ],
)
def test_even_pressure_and_shear_pass_the_patch_test(kinds, orders, elements, method):
    kinds = [{"t": MeshTet, "h": MeshHex}[kind] for kind in kinds]
    assembly, pressure, shear = sheared_blocks(kinds, orders, elements)
    result = solve_assembly(assembly, [0.4, 1.0], method=method)
    assert result.converged.values.all()
    accuracy = 1e-7 if isinstance(method, LatinMethod) else 1e-9
    traction, jump = result.traction.values[1], result.jump.values[1]
    np.testing.assert_allclose(traction[:, 0], -pressure, rtol=accuracy)
    np.testing.assert_allclose(np.hypot(*traction[:, 1:].T), shear, rtol=accuracy)
    np.testing.assert_allclose(jump - jump[0], 0.0, atol=accuracy * abs(jump).max())
    assert result.point_area.values.min() > 0.0
    np.testing.assert_allclose(result.point_area.values.sum(), EDGE**2, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [MeshTet, MeshHex])
def test_a_bump_on_a_block_is_pressed_as_hertz_has_it(kind):
    force, radius, E, nu = 400.0, 1.0, 210e9, 0.3  # N, m
    modulus = E / (1.0 - nu**2)
    contact = hertz.sphere_radius(force, radius, modulus)
    axis = contact * graded(0.4, 1.2, 6.0, 2.5)
    names = {"bottom": (2, 0.0), "top": (2, axis[-1]), "left": (0, 0.0), "front": (1, 0.0)}
    mesh = kind.init_tensor(axis, axis, axis).with_boundaries(
        {name: (lambda x, i=i, at=at: near(at)(x[i])) for name, (i, at) in names.items()}
    )
    quarter = Body(
        mesh,
        Elastic(E, nu),
        supports={"left": (0.0, None, None), "front": (None, 0.0, None)},
        tractions={"top": (0.0, 0.0, -0.25 * force / axis[-1] ** 2)},
        element=element_of_order(mesh, 2),
    )
    line = np.linspace(0.0, axis[-1], 200)
    x, y = (entry.ravel() for entry in np.meshgrid(line, line))
    bump = GapMap(np.column_stack([x, y]), (x**2 + y**2) / (2.0 * radius))
    ground, face = GROUND
    interface = Interface((ground, 0), (face, "bottom"), RigidContact(), gap=bump)
    result = solve_assembly(Assembly((quarter,), (interface,)), method=LatinMethod())
    assert result.converged.values.all()
    pressure, area = -result.traction.values[0, :, 0], result.point_area.values
    distance = np.hypot(*result.point_position.values.T[:2])
    assert pressure @ area == pytest.approx(0.25 * force, rel=1e-6)
    assert moment_radius(distance, pressure, area) == pytest.approx(contact, rel=0.03)
    middle = pressure[np.argmin(distance)]
    assert middle == pytest.approx(1.5 * force / (np.pi * contact**2), rel=0.08)


@pytest.mark.parametrize(("kind", "order", "points"), [("h", 2, 25), ("t", 2, 9), ("h", 1, 9)])
def test_nodes_with_an_area_are_points_of_matching_faces(kind, order, points):
    """Slip begins in a part of a facet: fewer points miss a tenth of the damping of a beam."""
    mesh = {"t": MeshTet, "h": MeshHex}[kind]
    assembly, *_ = sheared_blocks((mesh, mesh), (order, order), (FEW, FEW))
    assert len(cut_assembly(assembly).joints[0].position) == points

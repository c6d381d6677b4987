"""The parts of a contact problem: slip, local law, mesh files."""

import meshio
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from skfem import MeshHex, MeshQuad, MeshTet, MeshTri

from multiscale.fe.elasticity import prepare_elements
from multiscale.fe.faces import face_of
from multiscale.laws.bulk import NeoHookean
from multiscale.macro import Body, Contact, FiniteAssembly, RigidPlane, load_mesh, solve_contact
from multiscale.macro.continuum.contact_newton import linearise_contact
from tests.contact_scenes import block, moved, rotation_2d
from tests.support import alart_curnier

RUBBER = NeoHookean(2e7, 0.3)


def rotation(d, angle):
    if d == 2:
        return rotation_2d(angle)
    return Rotation.from_rotvec(angle * np.array([1.0, 0.5, -0.3])).as_matrix()


def curved_pair(d, *, bend=0.1, law=RUBBER, supports=None, **contact):
    """A short block on a longer block; their common surface is wavy, their meshes do not match."""
    kind = MeshQuad if d == 2 else MeshHex
    lower = block(
        kind, (8, *(3,) * (d - 2), 2), (-0.5, *(0.0,) * (d - 1)), (1.5, *(1.0,) * (d - 1))
    )
    upper = block(
        kind, (5, *(2,) * (d - 2), 2), (0.0,) * (d - 1) + (1.0,), (1.0,) * (d - 1) + (2.0,)
    )
    bodies = {}
    for name, mesh in (("lower", lower), ("upper", upper)):
        wave = bend * np.sin(np.pi * mesh.p[0]) * np.isclose(mesh.p[-1], 1.0)
        x = np.concatenate([mesh.p[:-1], (mesh.p[-1] + wave)[None]])
        fixed = {"bottom" if name == "lower" else "top": (supports or {}).get(name, (0.0,) * d)}
        bodies[name] = Body(moved(mesh, x), law, fixed)
    joint = Contact(("upper", "bottom"), ("lower", "top"), 0.8, **contact)
    return FiniteAssembly(bodies, {"joint": joint})


def step_jump(problem, before, now):
    """Gap and slip between two placements x -> function(body, x), shape (nodes, d), m."""
    d = problem.start.shape[1]
    motion = [
        np.concatenate(
            [
                (place(name, body.mesh.p.T) - body.mesh.p.T).ravel()
                for name, body in problem.bodies.items()
            ]
        )
        for place in (before, now)
    ]
    start = problem.couple(np.zeros(problem.start.size), 0.0)
    couplings = [problem.couple(u, 1.0, start) for u in motion]
    jump = problem.jump(*couplings, motion, (1.0, 1.0))
    return jump.reshape(-1, d)[couplings[0].transmits[:, 0] & couplings[1].transmits[:, 0]]


def slid(distance, turn=None, shift=0.0):
    """Both bodies turned, the upper one slid before by a distance along x."""

    def place(name, x):
        x = x + (distance * np.eye(x.shape[1])[0] if name == "upper" else 0.0)
        return x @ (np.eye(x.shape[1]) if turn is None else turn).T + shift

    return place


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("finite_sliding", [False, True])
def test_the_slip_between_bodies_is_the_slip_of_the_step(d, finite_sliding):
    problem = curved_pair(d, bend=0.0, finite_sliding=finite_sliding)
    jump = step_jump(problem, slid(0.1), slid(0.25))
    np.testing.assert_allclose(jump[:, 1], -0.15, rtol=1e-12)
    np.testing.assert_allclose(jump[:, [0, *range(2, d)]], 0.0, atol=1e-13)


@pytest.mark.parametrize("finite_sliding", [False, True])
def test_the_slip_on_an_obstacle_is_the_slip_of_the_step(finite_sliding):
    body = Body(block(MeshQuad, (3, 2), (0, 0), (1, 1)), RUBBER, {"top": (0.0, 0.0)})
    floor = RigidPlane((0.0, 0.0), (0.0, 1.0))
    contact = Contact(("upper", "bottom"), floor, 0.8, finite_sliding)
    problem = FiniteAssembly({"upper": body}, {"joint": contact})
    jump = step_jump(problem, slid(0.1), slid(0.25))
    np.testing.assert_allclose(jump[:, 1], -0.15, rtol=1e-12)
    np.testing.assert_allclose(jump[:, 0], 0.0, atol=1e-13)


@pytest.mark.parametrize("d", [2, 3])
def test_gap_and_slip_do_not_change_under_a_rigid_motion_of_both_bodies(d):
    problem = curved_pair(d, finite_sliding=True)
    turn = rotation(d, 1.2)
    stuck = step_jump(problem, slid(0.1), slid(0.1, turn, 3.0))
    assert np.abs(stuck[:, 0]).max() > 1e-3  # there is a gap that turns
    np.testing.assert_allclose(stuck[:, 1:], 0.0, atol=1e-13)
    first, other = (step_jump(problem, slid(0.1), slid(0.14, R, 3.0)) for R in (None, turn))
    np.testing.assert_allclose(other[:, 0], first[:, 0], atol=1e-13)
    sizes = [np.linalg.norm(jump[:, 1:], axis=1) for jump in (first, other)]
    np.testing.assert_allclose(sizes[1], sizes[0], atol=1e-13)
    assert sizes[0].max() == pytest.approx(0.04, rel=0.1)


@pytest.mark.parametrize("d", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_bodies_that_stick_and_turn_keep_their_tractions_and_dissipate_no_work(d):
    def path(lift):
        def component(i):
            def move(x, time):
                place = np.array(x)
                place[-1] -= lift * min(time, 1.0)
                turned = np.einsum("ij,j...->i...", rotation(d, max(0.0, time - 1.0)), place)
                return turned[i] - x[i]

            return move

        return tuple(component(i) for i in range(d))

    supports = {"lower": path(0.0), "upper": path(0.02)}
    problem = curved_pair(d, supports=supports, finite_sliding=True, fitted=True)
    pressed, *turned = (
        step.unwrap().contact["joint"] for step in solve_contact(problem, (1.0, 1.6, 2.2))
    )
    shear = np.linalg.norm(pressed.traction[1:], axis=0)
    top = pressed.pressure.max()
    assert shear.max() > 0.1 * top
    for surface in turned:
        np.testing.assert_allclose(surface.pressure, pressed.pressure, atol=1e-6 * top)
        size = np.linalg.norm(surface.traction[1:], axis=0)
        np.testing.assert_allclose(size, shear, atol=1e-6 * top)
        work = np.sum(surface.area * np.sum(surface.traction[1:] * surface.slip, axis=0))
        assert abs(work) < 1e-9 * 0.02 * np.sum(surface.area * surface.pressure)


def local_data(components, seed=6):
    rng = np.random.default_rng(seed)
    n = 200
    reaction, jump = rng.normal(size=(2, n, components))
    unit = np.ones((n, components), dtype=bool)
    return reaction, jump, rng.uniform(0.0, 1.0, n), rng.uniform(0.5, 2.0, n), unit


@pytest.mark.parametrize("components", [1, 2, 3])
def test_the_local_law_is_alart_and_curniers(components):
    r, j, mu, rho, stored = local_data(components)
    residual = linearise_contact(r, j, mu, rho, stored).residual
    np.testing.assert_allclose(residual.T, alart_curnier(j.T, r.T, mu, rho), atol=1e-14)


@pytest.mark.parametrize("components", [1, 2, 3])
def test_the_derivatives_of_the_local_law_are_differences(components):
    r, j, mu, rho, stored = local_data(components)
    stored[:40, -1] = False  # a component that a support holds
    law = linearise_contact(r, j, mu, rho, stored)
    for k in range(components):
        step = np.zeros((1, components))
        step[0, k] = 1e-7
        for derivative, by_r, by_j in ((law.by_reaction, step, 0.0), (law.by_jump, 0.0, step)):
            above, below = (
                linearise_contact(r + sign * by_r, j + sign * by_j, mu, rho, stored).residual
                for sign in (1.0, -1.0)
            )
            difference = (above - below) / 2e-7
            np.testing.assert_allclose(derivative[:, :, k], difference, atol=1e-6)


SHAPES = {
    "triangle": MeshTri,
    "quad": MeshQuad,
    "tetra": MeshTet,
    "hexahedron": MeshHex,
}


@pytest.mark.parametrize("kind", SHAPES)
def test_a_mesh_file_keeps_its_shape_and_its_names(kind, tmp_path):
    d = SHAPES[kind]().dim()
    mesh = block(SHAPES[kind], (3, 2, 2)[:d], (0.0,) * d, (2.0, 1.0, 3.0)[:d])
    cells = mesh.t.T
    if kind == "hexahedron":  # scikit-fem numbers the corners otherwise than VTK
        cells = cells[:, [0, 3, 6, 2, 1, 5, 7, 4]]
    facet = {"triangle": "line", "quad": "line", "tetra": "triangle", "hexahedron": "quad"}[kind]
    surface = face_of(mesh, "top")
    facets = surface.nodes[surface.facets]
    points = np.vstack([mesh.p, np.zeros((3 - d, mesh.p.shape[1]))]).T
    tags = [np.full(len(cells), 1), np.full(len(facets), 2)]
    meshio.Mesh(
        points,
        [(kind, cells), (facet, facets)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"solid": np.array([1, d]), "top": np.array([2, d - 1])},
    ).write(tmp_path / "block.msh", file_format="gmsh22", binary=False)

    entry = load_mesh(tmp_path / "block.msh", scale=1e-3)
    assert isinstance(entry, SHAPES[kind])
    elements = prepare_elements(entry)
    assert elements.weight.min() > 0.0
    assert elements.weight.sum() == pytest.approx(1e-3**d * (2.0 if d == 2 else 6.0))
    assert len(entry.boundaries["top"]) == len(facets)
    middle = entry.p[:, entry.facets[:, entry.boundaries["top"]]].mean(axis=1)
    np.testing.assert_allclose(middle[-1], 1e-3 * (1.0, 3.0)[d - 2])

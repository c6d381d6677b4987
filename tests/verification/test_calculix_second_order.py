"""Two plates of quadratic tetrahedra against CalculiX: tied, and by a law of one stiffness."""

import re

import numpy as np
import pytest
from scipy.spatial import cKDTree
from skfem import MeshTet

from multiscale.fe.elasticity import element_of_order
from multiscale.laws import Sliders, Tabulated
from multiscale.laws.bulk import Elastic
from multiscale.macro import AssembledNewton, Assembly, Body, Interface, solve_assembly
from multiscale.macro.continuum.body import load_vector
from multiscale.macro.vibration import press_structure, structure_mass, tangent_modes
from tests.calculix import needs_calculix, run_calculix, write_body
from tests.contact_scenes import block

SIZE = np.array([0.04, 0.01, 0.004])  # m, of the lower plate
BEGIN = 0.01  # of the upper plate along x, m
# a pressure so low that the stiffness of stresses, which CalculiX counts, changes no mode
PRESSURE, PUSH, DENSITY, FRICTION, RATIO = 1e6, 1.0, 7850.0, 0.5, 0.8
FACES = ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0))  # corners of the faces S1 to S4
EDGES = ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))

pytestmark = [pytest.mark.slow, needs_calculix]


def plates(stiffness, elements):
    """Pressed plates with meshes that do not match; the upper plate is pushed up.

    The lower plate is fixed at its end: the joint passes on bending and shear.
    """

    def push(position, time):
        return np.full(position.shape[1], max(time - 1.0, 0.0) * PUSH / (SIZE[1] * SIZE[2]))

    def press(way):
        return lambda x, time: way * min(time, 1.0) * PRESSURE * (x[0] > BEGIN)

    bodies = []
    for k, count in enumerate(((12, 3, 1), (*elements, 1))):
        low = np.array([k * BEGIN, 0.0, k * SIZE[2]])
        mesh = block(MeshTet, count, low, [*SIZE[:2], (k + 1) * SIZE[2]])
        loads = {("bottom", "top")[k]: (0.0, 0.0, press((1.0, -1.0)[k]))}
        loads |= {"right": (0.0, 0.0, push)} if k else {}
        fixed = {} if k else {"left": (0.0, 0.0, 0.0)}
        bodies.append(Body(mesh, Elastic(210e9, 0.3), fixed, loads, element_of_order(mesh, 2)))
    normal = Tabulated(np.array([0.0, stiffness]), np.array([0.0, -1.0]))
    law = Sliders(normal, FRICTION, RATIO, pressures=(1.0, 1e9))
    return Assembly(bodies, (Interface((0, 1), ("top", "bottom"), law),), times=(1.0, 2.0))


def deck(assembly, joint):
    """Write both bodies, mm and MPa, pressed in a first step and then pushed."""
    lines, first, starts = [], (1, 1), []
    for k, body in enumerate(assembly.bodies):
        mesh, x = body.mesh, body.basis.doflocs.T
        corners, p = mesh.t.T.copy(), mesh.p.T
        edge = p[corners[:, 1:]] - p[corners[:, :1]]
        turned = np.linalg.det(edge) < 0.0
        corners[turned] = corners[turned][:, [0, 2, 1, 3]]
        middle = np.stack([p[corners[:, list(pair)]].mean(axis=1) for pair in EDGES], axis=1)
        nodes = cKDTree(x).query(np.concatenate([p[corners], middle], axis=1))[1]
        starts.append(first[0])
        part = (mesh, k, "C3D10", 1e3 * x, nodes, FACES, first, ("top", "bottom")[k])
        more, _, first = write_body(*part)
        lines += more
    fixed = starts[0] + assembly.bodies[0].nodes("left")
    lines += ["*NSET, NSET=HELD", *map(str, fixed)]
    lines += [
        "*MATERIAL, NAME=STEEL",
        "*ELASTIC",
        "210000., .3",
        "*DENSITY",
        f"{1e-12 * DENSITY:.6g}",
    ]
    lines += [*joint, "*BOUNDARY", "HELD, 1, 3"]
    for time in (1.0, 2.0):
        lines += ["*STEP, INC=1000", "*STATIC", ".5, 1.", "*CLOAD"]
        for body, start in zip(assembly.bodies, starts, strict=True):
            force = load_vector(body, time).reshape(-1, 3)
            at = np.argwhere(np.abs(force) > 1e-9 * np.abs(force).max())
            lines += [f"{start + a}, {i + 1}, {force[a, i]:.12g}" for a, i in at]
        lines += ["*NODE PRINT, NSET=N1, FREQUENCY=1000", "U", "*END STEP"]
    return [*lines, "*STEP, PERTURBATION", "*FREQUENCY", "3", "*END STEP"]


def by_calculix(assembly, joint, folder):
    """Mean displacement of the pushed face by the push, m, and the first frequencies, Hz."""
    statics, modes = run_calculix(folder, deck(assembly, joint)).split("E I G E N", 1)
    tables = re.split(r" displacements .*\n", statics)[1:]
    u = [np.loadtxt(item.splitlines(), usecols=3) for item in (tables[0], tables[-1])]
    upper = assembly.bodies[1]
    force = np.subtract(*(load_vector(upper, time)[2::3] for time in (2.0, 1.0)))
    matches = re.findall(r"^ +\d+ .* (\S+) +\S+ *$", modes.split("P A R T")[0], re.MULTILINE)
    return 1e-3 * force @ (u[1] - u[0]) / PUSH, np.array(matches[:3], dtype=float)


@pytest.mark.parametrize(
    ("stiffness", "elements", "joint"),
    [
        # nodes that are tied to facets of another mesh are stiffer by 2 %
        pytest.param(1e16, (9, 3), ["*TIE, NAME=JOINT", "JOINT1, JOINT0"], id="tied"),
        pytest.param(
            1e13,
            (8, 4),
            [
                "*SURFACE INTERACTION, NAME=LAW",
                *("*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR", f"{1e-9 * 1e13}, 0."),
                *("*FRICTION", f"{FRICTION}, {1e-9 * RATIO * 1e13}"),
                "*CONTACT PAIR, INTERACTION=LAW, TYPE=SURFACE TO SURFACE",
                "JOINT1, JOINT0",
            ],
            id="law of one stiffness",
        ),
    ],
)
def test_stiffness_and_modes_of_pressed_plates_agree_with_calculix(
    stiffness, elements, joint, tmp_path
):
    assembly = plates(stiffness, elements)
    path = np.array([[1.0, 0.0], [0.0, 1.0]])
    result = solve_assembly(assembly, path, method=AssembledNewton())
    assert result.converged.values.all()
    assert result.traction.values[..., 0].max() < 0.0  # closed everywhere
    direct = result.displacement.values[:, assembly.bodies[0].basis.N :, 2]
    force = np.subtract(*(load_vector(assembly.bodies[1], time)[2::3] for time in (2.0, 1.0)))
    moved = force @ (direct[1] - direct[0]) / PUSH
    rest = press_structure(assembly, path[:1])
    mass = structure_mass(rest.free, assembly.bodies, [DENSITY] * 2)
    frequency = tangent_modes(rest.free, rest.tangent(), mass, 3).frequency
    expected, modes = by_calculix(assembly, joint, tmp_path)
    assert moved == pytest.approx(expected, rel=0.02)
    np.testing.assert_allclose(frequency, modes, rtol=0.01)

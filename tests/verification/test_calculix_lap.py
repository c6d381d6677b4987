"""A bolted lap joint against CalculiX, on the same meshes, with the law as `export` writes it."""

import re
from dataclasses import dataclass

import numpy as np
import pytest

from multiscale.fe.faces import face_operator
from multiscale.fe.mesh_file import HEX_ORDER
from multiscale.laws import PowerLaw, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import AssembledNewton
from multiscale.macro.bodies import LapShape, lap_joint
from multiscale.macro.substructures import joint_path, load_joint
from multiscale.upscaling import (
    assume_shear,
    fit_law,
    sliders_from_dataset,
    write_pressure_overclosure,
)
from tests.calculix import needs_calculix, run_calculix, write_body
from tests.support import keep_ignoring_broken_pipes
from tests.upscaling.responses import response_of

PRELOAD, SHEAR, STEPS, FRICTION, RATIO = 30e6, 2e6, 8, 0.2, 0.8
SHAPE = LapShape(0.1, 0.04, 0.008, 0.04, 0.009, 0.018, 0.01, layers=1)
FACES = np.array(  # corners of a hexahedron on its faces S1 to S6
    [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]
)
PATH = ((0.0, 0.0), (1.0, 0.0), (1.5, 1.0), (2.5, -1.0), (3.5, 1.0))
"""Times, and shear over its amplitude: the first unit of time brings the preload."""

pytestmark = [pytest.mark.slow, needs_calculix]


@dataclass(frozen=True)
class Case:
    """A law for either code, and the distance of mean planes at first contact, mm."""

    sliders: Sliders
    interaction: str
    apart: float


def rough_case(path):
    """A fitted law as the package writes it for CalculiX."""
    p = np.geomspace(1e5, 2e8, 14)
    gap = 0.5e-6 * np.log(2e9 / p)[None]
    fitted = fit_law(response_of(gap, p, area=p[None] / 5e9, nominal=False), n_samples=0)
    law = assume_shear(fitted, friction=FRICTION, stiffness_ratio=RATIO)
    options = {"friction_for": "calculix", "stick_pressure": 0.5 * PRELOAD, "tolerance": 2e-2}
    write_pressure_overclosure(law, path, **options)
    text = path.read_text()
    sliders = sliders_from_dataset(law, pressures=(0.1 * PRELOAD, 3.0 * PRELOAD), slabs=1)
    return Case(sliders, text, float(re.search(r"planes (\S+) mm apart", text)[1]))


def linear_case(path):
    """A law that is as stiff at every pressure, so that both codes stick with one stiffness."""
    first, stiffness = 4e-6, 4e13  # m, Pa/m
    law = PowerLaw(stiffness * first, first, 1.0)
    text = f"""*SURFACE INTERACTION, NAME=ROUGH
*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=TABULAR
0, 0
{1e-6 * stiffness * 10.0 * first}, {1e4 * first}
*FRICTION
{FRICTION}, {1e-9 * RATIO * stiffness}
"""
    return Case(Sliders(law, FRICTION, RATIO, pressures=(1e5, 1e8), slabs=1), text, 1e3 * first)


def write_bodies(assembly, lower):
    """Nodes (mm), elements and named facets of both plates, the upper one lowered."""
    lines, facets, first = [], [], (1, 1)
    for number, (body, z) in enumerate(zip(assembly.bodies, (0.0, -lower), strict=True)):
        mesh = body.mesh
        corners = mesh.t[np.argsort(HEX_ORDER)].T  # in the order of VTK and CalculiX
        places = 1e3 * mesh.p.T + [0.0, 0.0, z]
        end = first[0] + np.unique(mesh.facets[:, mesh.boundaries["end"]])
        part = (mesh, number, "C3D8I", places, corners, FACES, first, "joint")
        more, named, first = write_body(*part)
        lines += [*more, f"*NSET, NSET=END{number}", *map(str, end)]
        facets.append(named)
    return lines, facets


def deck(assembly, case):
    """Lines of the model, mm and MPa; the faces overlap at the start so that they meet at once."""
    lower = 0.6 * case.apart
    lines, facets = write_bodies(assembly, lower)
    shear = [f"{time:g}, {factor:g}" for time, factor in PATH]
    meshed = face_operator(assembly.bodies[1].basis, "washer")[1].sum()  # m², less than the ring
    pressure = 1e-6 * PRELOAD * SHAPE.ring / meshed
    pressed = [f"{i}, P{s}, {pressure}" for facet in facets for i, s in facet["washer"]]
    return [
        *lines,
        *("*MATERIAL, NAME=STEEL", "*ELASTIC", "210000., .3"),
        *case.interaction.splitlines(),
        "*CONTACT PAIR, INTERACTION=ROUGH, TYPE=NODE TO SURFACE, SMALL SLIDING",
        "JOINT1, JOINT0",
        *("*BOUNDARY", "END0, 1, 3", "END1, 2, 2"),
        *("*AMPLITUDE, NAME=PRESS", "0, 0", "1, 1", "9, 1", "*AMPLITUDE, NAME=SHEAR", *shear),
        *("*TIME POINTS, NAME=TIMES, GENERATE", f"{0.5 / STEPS}, 3.5, {0.5 / STEPS}"),
        *("*STEP, INC=10000", "*STATIC", f"{0.5 / STEPS}, 3.5, 1e-6, {0.5 / STEPS}"),
        # mean planes that lie on each other overlap by their distance at first contact
        *("*BOUNDARY, AMPLITUDE=PRESS", f"END1, 3, 3, {lower - case.apart:.9g}"),
        *("*DLOAD, AMPLITUDE=PRESS", *pressed),
        "*DLOAD, AMPLITUDE=SHEAR",
        *(f"{i}, P{side}, {-1e-6 * SHEAR}" for i, side in facets[1]["end"]),
        *("*NODE PRINT, NSET=N1, TIME POINTS=TIMES", "U", "*END STEP"),
    ]


def loop_of_calculix(assembly, case, out):
    """Times, and mean displacement of the pulled end along the pull, m."""
    output = run_calculix(out, deck(assembly, case))
    tables = re.split(r" displacements .* time +(\S+)\n", output)[1:]
    times = np.array([float(time) for time in tables[::2]])
    u = np.array([np.loadtxt(table.split("\n"), usecols=1) for table in tables[1::2]])
    values, weight, _ = face_operator(assembly.bodies[1].basis, "end")
    return times, 1e-3 * u @ (values.T @ weight) / weight.sum()


@pytest.mark.parametrize(
    ("make_case", "width", "loss"),
    [
        pytest.param(linear_case, 0.002, 0.02, id="one stiffness"),
        # points under a small pressure stick too stiffly, slip early and dissipate twice as much
        pytest.param(rough_case, 0.03, 0.6, id="rough law"),
    ],
)
def test_the_loop_of_a_lap_joint_agrees_with_calculix(make_case, width, loss, tmp_path):
    pytest.importorskip("gmsh", exc_type=Exception)
    case = make_case(tmp_path / "law.inp")
    assembly = lap_joint(SHAPE, [Elastic(210e9, 0.3)] * 2, case.sliders)
    keep_ignoring_broken_pipes()
    loading = joint_path((PRELOAD,), SHEAR, cycles=1, steps=STEPS)
    result = load_joint(assembly, loading, method=AssembledNewton())
    mine = result["shear_displacement"].to_numpy()
    times, along = loop_of_calculix(assembly, case, tmp_path)
    swing = np.interp(1.5, times, along) - np.interp(2.5, times, along)
    cycle, shear = times >= 1.5, np.interp(times, *np.transpose(PATH))
    lost = SHEAR * SHAPE.width * SHAPE.thickness * np.trapezoid(shear[cycle], along[cycle])
    assert mine[STEPS] - mine[3 * STEPS] == pytest.approx(swing, rel=width)
    assert float(result["cycle_energy"][0]) == pytest.approx(lost, rel=loss)

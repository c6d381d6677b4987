"""CalculiX reads the law that is exported for it: two stiff blocks, pressed and then sheared."""

import re
import subprocess

import numpy as np
import pytest

from multiscale.upscaling import assume_shear, fit_law, law_from_dataset
from multiscale.upscaling.export import pressure_overclosure, write_pressure_overclosure
from tests.calculix import needs_calculix, run_calculix
from tests.support import text_of
from tests.upscaling.responses import exponential_gaps, response_of

EDGE, HEIGHT, STIFF = 10.0, 1.0, 2e8  # mm and MPa: the interface gives way, not the blocks
PRESSURE, FRICTION, RATIO = 20.0, 0.25, 0.8  # MPa
SLIPS = 2e-5, 4e-5, 4e-4  # mm: two that stick, and full slip

MODEL = text_of("two_blocks.inp")
SHEAR = """*STEP, NLGEOM=NO, INC=200
*STATIC
0.2, 1.
*BOUNDARY
TOP, 1, 1, {slip}
{prints}
*END STEP
"""
PRINTS = """*NODE PRINT, NSET=ALL, FREQUENCY=1000
U
*NODE PRINT, NSET=BASE, FREQUENCY=1000, TOTALS=ONLY
RF"""


def solve(folder, approach, pair):
    """Run CalculiX with an approach of the blocks, mm, and a type of contact pair.

    Returns displacements (step, node, 3), mm, and the force of the base (step, 3), N.
    """
    corners = [(0.0, 0.0), (EDGE, 0.0), (EDGE, EDGE), (0.0, EDGE)]
    planes = [0.0, HEIGHT, HEIGHT, 2.0 * HEIGHT]
    nodes = "\n".join(
        f"{4 * k + n + 1}, {x}, {y}, {z}"
        for k, z in enumerate(planes)
        for n, (x, y) in enumerate(corners)
    )
    text = MODEL.format(nodes=nodes, stiff=STIFF, approach=approach, pair=pair, prints=PRINTS)
    text += "".join(SHEAR.format(slip=slip, prints=PRINTS) for slip in SLIPS)
    output = run_calculix(folder, [text])
    number = r"\s+(-?\d\.\d+E[+-]\d+)"
    moved = re.findall(rf"^\s+\d+{number * 3}$", output, re.MULTILINE)
    force = re.findall(rf"total force.*\n\s*\n{number * 3}", output)
    steps = len(SLIPS) + 1
    u = np.array(moved, dtype=float).reshape(-1, 16, 3)
    return u[-steps:], np.array(force, dtype=float)[-steps:]


def press_and_shear(folder, pair, face_to_face=False, friction=True):
    """Export a law, run CalculiX with it, and return pressure, slips, shear and stick stiffness.

    Pressures are in MPa, slips in mm.
    """
    dataset = fit_law(response_of(exponential_gaps(4)), n_samples=0)
    dataset = assume_shear(dataset, friction=FRICTION, stiffness_ratio=RATIO)
    write_pressure_overclosure(
        dataset,
        folder / "rough.inp",
        friction_for="calculix" if friction else None,
        stick_pressure=1e6 * PRESSURE,
        tolerance=1e-2 if face_to_face else 5e-3,
        face_to_face=face_to_face,
    )
    law = law_from_dataset(dataset)
    gap = float(law.gap_at(np.array(1e6 * PRESSURE)))
    data = (float(dataset.attrs[f"pressure_{end}"]) for end in ("min", "max"))
    closed = 1e3 * (pressure_overclosure(law, tuple(data)).first_contact - gap)
    u, force = solve(folder, closed, pair)
    stiffness = 1e-9 * RATIO * float(law.stiffness(np.array(gap)))  # MPa/mm
    slip = u[1:, 8:12, 0].mean(axis=1) - u[1:, 4:8, 0].mean(axis=1)
    return force[0, 2] / EDGE**2, slip, -force[1:, 0] / EDGE**2, stiffness


@needs_calculix
@pytest.mark.parametrize(
    ("pair", "face_to_face"),
    [
        pytest.param("NODE TO SURFACE", False, id="nodes"),
        pytest.param("NODE TO SURFACE", True, id="nodes-face-table"),
        pytest.param("SURFACE TO SURFACE", True, id="faces"),
    ],
)
def test_calculix_presses_and_shears_blocks_by_the_law(tmp_path, pair, face_to_face):
    pressure, slip, carried, stiffness = press_and_shear(tmp_path, pair, face_to_face)
    assert pressure == pytest.approx(PRESSURE, rel=1e-2)
    np.testing.assert_allclose(carried[:2], stiffness * slip[:2], rtol=1e-2)
    assert carried[2] == pytest.approx(FRICTION * PRESSURE, rel=1e-2)


@needs_calculix
def test_calculix_presses_blocks_by_the_law_with_mortar(tmp_path):
    """Its shear with friction is wrong for linear laws, too, and not compared."""
    pressure, *_ = press_and_shear(tmp_path, "MORTAR", friction=False)
    assert pressure == pytest.approx(PRESSURE, rel=1e-2)


@needs_calculix
def test_the_head_of_a_plain_table_warns_of_faces_where_calculix_finds_no_load(tmp_path):
    with pytest.raises((ValueError, subprocess.CalledProcessError)):  # no step is finished
        press_and_shear(tmp_path, "SURFACE TO SURFACE")
    head = (tmp_path / "rough.inp").read_text()
    assert "carries no load: there write the table by multiscale export --face-to-face" in head

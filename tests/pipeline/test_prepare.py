"""Refusals of a run and its explanation before anything is solved."""

import numpy as np
import pytest
from typer.testing import CliRunner

from multiscale.cli import app
from multiscale.errors import CaseError
from multiscale.fe.mesh_file import box_mesh
from multiscale.pipeline import case_needs
from multiscale.pipeline.case import shipped_cases
from multiscale.pipeline.case_needs import prepare
from multiscale.pipeline.tables.structure_kind import Face, highest_pressure
from tests.pipeline.test_body_cases import BOLT, TEXT, WASHERS, meshes  # noqa: F401
from tests.pipeline.test_jointed_bodies import LAP
from tests.support import (
    TWO_BLOCKS,
    case_of,
    case_text,
    small_steel,
    write_body,
    write_law,
    write_scene,
)

LAW = '[interface]\nlaw = "law.nc"\nfriction = 0.2\nstiffness_ratio = 0.8\n'
BLOCKS = case_text("blocks_of_law")
STRUCTURES = {
    "blocks": (BLOCKS, "press the joint by about 25 MPa", (25.0, 25.0)),
    "stacked blocks": (
        TWO_BLOCKS.replace("[interface]\n", '[interface]\nlaw = "law.nc"\n'),
        "press the joints by about 5 MPa to 20 MPa",
        (5.0, 20.0),
    ),
    "lap joint": (LAP + LAW, "press the joint by about 3.1 MPa to 25 MPa", (3.1, 25.0)),
}


@pytest.mark.parametrize(("text", "sentence", "ends"), STRUCTURES.values(), ids=STRUCTURES)
def test_loads_far_from_the_data_of_the_law_are_refused(tmp_path, text, sentence, ends):
    case = case_of(tmp_path, text)
    low, high = 1e6 * np.array(ends)
    for data in ((2.2 * high, 1e9), (1e3, 0.45 * low)):
        write_law(tmp_path / "law.nc", data)
        with pytest.raises(CaseError, match=rf"{sentence}.* \(law\.nc\).* in \[interface\]"):
            prepare(case)
    for data in ((1.9 * high, 1e9), (1e3, 0.55 * low)):
        write_law(tmp_path / "law.nc", data)
        prepare(case)
    write_law(tmp_path / "law.nc", (2.2 * high, 1e9))
    prepare(case_of(tmp_path, text, ("[interface]", "[interface]\nextrapolate = true")))


CLAMPED = ("{ pull = 1 }", "{ preload = 1 }")
BODIES = {
    "press, too low": ([], "", ("21 MPa", "100 MPa")),
    "press, too high": ([], "", ("0.1 MPa", "4.9 MPa")),
    "bolt, too low": ([*WASHERS, CLAMPED], BOLT, ("1 GPa", "9 GPa")),
    "bolt, too high": ([*WASHERS, CLAMPED], BOLT, ("1 kPa", "0.1 MPa")),
}
STATED = '["0.1 MPa", "100 MPa"]'


@pytest.mark.parametrize(("pairs", "more", "ends"), BODIES.values(), ids=BODIES)
def test_loads_of_bodies_far_from_a_stated_law_are_refused(meshes, pairs, more, ends):  # noqa: F811
    pull = [] if more else [("{ pull = 1 }", "{ press = 1 }")]
    far = (STATED, f'["{ends[0]}", "{ends[1]}"]')
    with pytest.raises(CaseError, match=r"cover.bottom on housing.top, by about .* state a law"):
        prepare(case_of(meshes, TEXT + more, *pairs, *pull, far))
    prepare(case_of(meshes, TEXT + more, *pairs, *pull))


def test_a_small_body_next_to_the_middle_of_a_large_body_is_pressed_on_its_face(meshes):  # noqa: F811
    """10 MPa on a block of 10 x 10 mm at the corner of a plate with a face on side 2 or 1."""
    block = box_mesh((0.01, 0.01, 0.01), (1, 1, 1), origin=(0.05, 0.03, 0.01))
    write_body(meshes / "block.msh", block)
    small = ('mesh = "cover.msh"', 'mesh = "block.msh"')
    alone, narrow = (
        ("{ press = 1 }, { pull = 1 }", "{ press = 1 }"),
        (STATED, '["8 MPa", "12 MPa"]'),
    )
    sides = '"housing.top", "cover.bottom"'
    prepare(case_of(meshes, TEXT, small, alone, narrow))
    prepare(case_of(meshes, TEXT, small, alone, narrow, (sides, '"cover.bottom", "housing.top"')))


def test_a_bolt_is_not_counted_on_an_interface_that_it_may_not_press(meshes):  # noqa: F811
    """A cover on a bolted plate, with a law of small pressures: 20 kN are 4 MPa on two faces."""
    top = box_mesh((0.06, 0.04, 0.01), (2, 3, 1), origin=(0.0, 0.0, 0.02))
    write_body(meshes / "top.msh", top)
    body = TEXT[TEXT.index('[[structure.bodies]]\nname = "cover"') : TEXT.index("[[structure.int")]
    third = body.replace('"cover', '"top')
    joint = TEXT[TEXT.index("[[structure.interfaces]]") : TEXT.index("[[structure.loads]]")]
    soft = joint.replace('"housing.top", "cover.bottom"', '"cover.top", "top.bottom"')
    soft = soft.replace(STATED, '["0.1 kPa", "1 kPa"]')
    text = TEXT.replace(joint, third + joint + soft) + BOLT
    prepare(case_of(meshes, text, *WASHERS, CLAMPED))


def test_pressures_of_a_load_above_an_interface_equal_a_beam():
    """A block of width w under P at the eccentricity e: P/A (1 + 6 e / w) at its edge."""
    mesh = box_mesh((0.02, 0.02, 0.01), (2, 2, 1))
    base, top = (Face.at(mesh, name) for name in ("bottom", "top"))
    assert base.area == pytest.approx(4e-4)
    aside = top._replace(centroid=top.centroid + np.array([0.003, 0.0, 0.0]))
    force = np.array([0.0, 0.0, -1e3])
    for face, factor in ((top, 1.0), (aside, 1.0 + 6 * 0.003 / 0.02)):
        assert highest_pressure(base, [(force, face)]) == pytest.approx(2.5e6 * factor)


def test_a_law_of_another_case_is_known_by_its_cells(meshes):  # noqa: F811
    text = small_steel(2).split("[structure]")[0]
    (meshes / "cells.toml").write_text(text)
    stated = TEXT[TEXT.index("[structure.interfaces.exp") : TEXT.index("[[structure.loads]]")]
    direct = (stated, ""), ("friction = 0.2", 'friction = 0.2\nlaw = "cells.toml"')
    prepare(case_of(meshes, TEXT, *direct))
    with pytest.raises(CaseError, match=r"5 GPa, .* 2 MPa to 240 MPa \(cells\.toml\)"):
        prepare(case_of(meshes, TEXT, *direct, ('"10 MPa"', '"5 GPa"')))


def explain(path):
    """Exit status and all output of a command that explains a case."""
    result = CliRunner().invoke(app, ["run", str(path), "--explain"])
    return result.exception


def test_a_case_that_a_run_refuses_its_explanation_refuses(tmp_path):
    points = np.arange(64)
    waves = np.sin(0.7 * points)[:, None] + np.cos(0.9 * points)
    np.savetxt(tmp_path / "map.txt", waves, header="Width: 64 um\nHeight: 64 um\nValue units: nm")
    text = small_steel(5)
    body = text[text.index("[body_1.surface]") : text.index("[body_2]")]
    few = (
        (body, '[body_1.surface]\nfile = "map.txt"\n'),
        ('["800 um", "800 um"]', '["64 um", "64 um"]'),
    )
    scenes = {
        "has 4 separate windows .* but 5 are needed": few,
        "cannot carry short_cutoff": [("[36, 36]", "[20, 20]")],
    }
    for sentence, pairs in scenes.items():
        error = explain(write_scene(tmp_path, text, *pairs))
        assert error is not None
        with pytest.raises(CaseError, match=sentence):
            raise error
    assert explain(write_scene(tmp_path, text)) is None
    tyre = shipped_cases()["tyre_on_road"].read_text(encoding="utf-8")
    for sentence, pair in (
        ("cannot carry short_cutoff", ('"1 mm"', '"0.1 mm"')),
        (r"presses the road by about 3 MPa.* in \[sliding\]", ('"300 kPa"', '"3 MPa"')),
    ):
        with pytest.raises(CaseError, match=sentence):
            prepare(case_of(tmp_path, tyre, pair))


@pytest.mark.parametrize("command", ["run", "macro"])
def test_a_case_with_too_much_memory_is_explained_and_refused(tmp_path, monkeypatch, command):
    monkeypatch.setattr(case_needs, "usable_memory", lambda: 1)
    write_law(tmp_path / "law.nc")
    path = write_scene(tmp_path, TWO_BLOCKS, ("[interface]", '[interface]\nlaw = "law.nc"'))
    arguments = [command, str(path), "-o", str(tmp_path / "out.nc"), "--explain"]
    refused = CliRunner().invoke(app, arguments)
    assert "unknowns per contact" in refused.output
    with pytest.raises(CaseError, match="GB of memory, and this machine has"):
        raise refused.exception
    assert CliRunner().invoke(app, [*arguments, "--force"]).exit_code == 0
    assert not (tmp_path / "out.nc").exists()

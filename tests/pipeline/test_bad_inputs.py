"""What users get wrong, from typing errors to surfaces without heights: a sentence and a status."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from multiscale.io.csv_tables import read_table
from multiscale.pipeline import load_case
from tests.support import case_text, refused_rows, small_steel, write_law, write_scene

STEEL = small_steel(3)

PLATE = case_text("plate")
GRID = case_text("grid")
GRAINS = case_text("grains")
LAP = case_text("lap_of_law")


def measured(more=""):
    """Text of a case with the file ``map.txt`` as first surface."""
    start, end = STEEL.index("rms_height"), STEEL.index("\n\n[body_2]")
    text = STEEL[:start] + f'file = "map.txt"\n{more}' + STEEL[end:]
    second = text.index("[body_2.surface]")
    return text[:second] + text[text.index("[cell]") :]


BASES = {
    "commanded": STEEL,
    "empty": "",
    "huge_plate": PLATE,
    "huge_grid": GRID,
    "countless_grains": GRAINS,
    "lap_without_law": LAP,
    "missing_map": measured(),
}


@pytest.mark.parametrize(("base", "patches", "sentence"), refused_rows(*BASES))
def test_a_case_that_cannot_be_meant_is_refused_at_once(command, tmp_path, base, patches, sentence):
    write_scene(tmp_path, BASES[base], *patches)
    answer = command("run", "scene.toml", "--jobs", "1")
    refused(answer, "")
    assert re.search(sentence, answer[2])


def refused(answer, sentence, status=1):
    code, out, text = answer
    assert code == status, (out, text)
    assert "Traceback" not in text
    assert sentence in text, text
    assert "=True" not in text  # no advice for scripts


def bumps():
    return 1e-6 * np.random.default_rng(3).standard_normal((24, 24))


TOLD = 'size = ["1 mm", "1 mm"]\nunit = "m"'
MAPS = {
    "holes": (np.where(np.arange(24) == 3, np.nan, bumps()), TOLD, "set fill_undefined to true"),
    "line scan": (bumps().ravel(), TOLD.replace(', "1 mm"', ""), "profile"),
    "text": (np.array([["a", "b"]]), TOLD, "contains an array of shape"),
    "untold": (bumps(), "", "no lateral size and no unit of length; give size and unit"),
    "wrong channel": (bumps(), f"{TOLD}\nchannel = 7", "height channels: 0"),
    "small map": (bumps(), TOLD.replace("1 mm", "9 um"), "window"),
}


@pytest.mark.parametrize("name", MAPS)
def test_a_map_without_use_is_refused(command, tmp_path, name):
    heights, keys, sentence = MAPS[name]
    with (tmp_path / "map.txt").open("wb") as file:
        np.save(file, heights)
    (tmp_path / "case.toml").write_text(measured(keys), encoding="utf-8")
    refused(command("run", "case.toml", "--jobs", "1"), sentence)


COMMANDS = tomllib.loads(
    Path(__file__).with_name("refused_commands.toml").read_text(encoding="utf-8")
)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_that_cannot_be_meant_is_refused(command, tmp_path, name):
    arguments, sentence, status = COMMANDS[name]
    (tmp_path / "case.toml").write_text(STEEL, encoding="utf-8")
    (tmp_path / "cells.toml").write_text(STEEL.partition("[structure]")[0], encoding="utf-8")
    (tmp_path / "grid.toml").write_text(GRID, encoding="utf-8")
    huge = PLATE.replace("[16, 16, 1]", "[100000, 100000, 10]")
    (tmp_path / "plate.toml").write_text(huge, encoding="utf-8")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "log.txt").touch()
    before = {*tmp_path.iterdir()}
    if "law.nc" in arguments:
        write_law(tmp_path / "law.nc")
    refused(command(*arguments.split()), sentence, status)
    assert {*tmp_path.iterdir()} - before <= {tmp_path / "law.nc"}


NODES = "x;y;z;fix_x;fix_y;fix_z;load_z\n0;0;0;1;1;1;0\n{};0;0;1;1;1;0\n0,5;0;0;0;0;0;-3\n"


def test_tables_of_spreadsheets_are_read(tmp_path):
    """A byte order mark, semicolons and decimal commas are how spreadsheets write in Europe."""
    file = tmp_path / "nodes.csv"
    file.write_text("\ufeff" + NODES.format("1,0"), encoding="utf-8")
    assert read_table(file)["x"] == [0.0, 1.0, 0.5]
    file.write_text(NODES.format("1,0").replace(";", "\t"), encoding="utf-8")
    assert read_table(file)["load_z"] == [0.0, 0.0, -3.0]
    (tmp_path / "case.toml").write_text("\ufeff" + GRID, encoding="utf-8")
    assert load_case(tmp_path / "case.toml").title == "grid"

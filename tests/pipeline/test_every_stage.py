"""Duties of every stage, on one small case each: schema, needs, tables, page, print, answers."""

import base64
import csv
import html
import re
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from multiscale.fe.mesh_file import box_mesh
from multiscale.pipeline import load_case, requirements, run
from multiscale.pipeline.showing import Table, answer_columns
from multiscale.pipeline.stage import WIDTH, Stage
from multiscale.report import FinishedRun, open_finished, show_run
from multiscale.report.page import SENTENCES
from multiscale.schema import MACRO_RESULT, SHOWN, unit_in
from tests.pipeline import test_body_cases as bodies
from tests.pipeline.test_fatigue_cases import TEXT as CYCLED
from tests.pipeline.test_growth_cases import BAR, VOLUME, write_bars
from tests.pipeline.test_leaking_cases import TEXT as RING
from tests.pipeline.test_sheared_cells import CHAIN
from tests.pipeline.test_slide import ELASTIC, SLIDE
from tests.pipeline.test_tyre import SMALL as TREAD
from tests.pipeline.test_vibration_cases import ONLY_PRESS, VIBRATION
from tests.support import SCENES, TWO_BLOCKS, slow, small_steel, write_body, write_law

CYCLES = '[cycles]\nshear = "0.5 MPa"\ncycles = 1\nsteps = 2\n'
BLOCKS = TWO_BLOCKS.replace("friction", 'law = "law.nc"\nfriction') + CYCLES
TEXTS = {
    "steel": small_steel(3),
    "ring": RING,
    "tread": TREAD,
    "blocks": BLOCKS,
    "bodies": bodies.TEXT,
    "vibration": ONLY_PRESS + VIBRATION,
    "fatigue": CYCLED,
    "cracks": VOLUME + BAR,
    "slide": ELASTIC + SLIDE,
    "sheared": CHAIN,
}
"""Cases of several stages each, by name; scenes are read from their files."""

FAST = ("steel", "blocks", "bodies", "vibration", "fatigue")
QUICK = (
    "cable_net",
    "equivalent_plate",
    "sudden_unloading",
    "plate",
    "deposit",
    "tensegrity_substructures",
)


@dataclass(frozen=True)
class Finished:
    """A finished run, its case, and its page."""

    case: object
    run: FinishedRun
    page: str

    @property
    def stages(self) -> list[tuple[Stage, object]]:
        """Stages and their datasets."""
        return [(stage, self.run.datasets[stage.name]) for stage in self.run.stages]


def write_files(folder: Path) -> None:
    """Write the meshes and the law that the cases name."""
    write_law(folder / "law.nc")
    write_bars(folder)
    write_body(folder / "part.msh", box_mesh((0.01, 0.01, 0.01), (1, 1, 1)))
    size = (bodies.LONG, bodies.WIDE, bodies.HIGH)
    for name, place, counts in (("housing", 0.0, (3, 2, 1)), ("cover", bodies.HIGH, (2, 3, 1))):
        write_body(folder / f"{name}.msh", box_mesh(size, counts, origin=(0.0, 0.0, place)))


@pytest.fixture(
    scope="module", params=[*FAST, *QUICK, *slow(*(text for text in TEXTS if text not in FAST))]
)
def finished(request, tmp_path_factory, text_run):
    if request.param in TEXTS:
        case, out, _ = text_run(request.param, TEXTS[request.param], write_files)
    else:
        case = load_case(SCENES / f"{request.param}.toml").quick()
        out = tmp_path_factory.mktemp(request.param) / "out"
        run(case, out)
        show_run(out)
    return Finished(case, open_finished(out), (out / "report.html").read_text(encoding="utf-8"))


def test_datasets_follow_their_schemas_and_carry_labels(finished):
    for stage, dataset in finished.stages:
        stage.schema.check(dataset)
        stage.check(dataset)
        for name in set(dataset.variables) & SHOWN.keys():
            assert dataset[name].attrs.get("long_name", SHOWN[name].label) == SHOWN[name].label


def test_needs_of_all_stages_are_reported(finished):
    needs = requirements(finished.case)
    assert needs.memory > 0
    assert [cost.stage for cost in needs.costs] == [stage.name for stage, _ in finished.stages]


def test_a_stage_is_out_of_date_by_its_tables_and_tables_that_it_takes_from(finished):
    def closure(stage):
        read = {"structure"} if stage.reads is None else set(stage.reads)
        taken = (
            schema_name
            for schema_name in stage.takes
            if schema_name.asked_for(finished.case.tables)
        )
        return read.union(*map(closure, taken))

    other = finished.case.model_copy(update={"title": f"{finished.case.title}, again"})
    for stage, dataset in finished.stages:
        assert dataset.attrs["identity"] == stage.identity(finished.case)
        changed = stage.identity(other) != stage.identity(finished.case)
        assert changed == ("title" in closure(stage)), stage.name


def test_every_figure_and_every_table_stands_on_the_page(finished):
    plain = html.unescape(re.sub(r"<[^>]+>", " ", finished.page)).replace("\u00a0", " ")
    for section in finished.run.sections():
        for name in section.figures:
            file = finished.run.out / "figures" / f"{name}.png"
            assert base64.b64encode(file.read_bytes()).decode() in finished.page, name
        for row in section.rows:
            assert all(cell in plain for cell in row), section.heading


def test_print_and_download_have_the_table_of_the_page(finished):
    printed = [line.split() for line in finished.run.lines(details=True)]
    downloads = re.findall(r'csv" href="data:text/plain;base64,([^"]+)"', finished.page)
    files = [
        [tuple(row) for row in csv.reader(StringIO(base64.b64decode(download).decode("utf-8-sig")))]
        for download in downloads
    ]
    for section in finished.run.sections():
        rows = [tuple(map(str, row)) for row in section.rows]
        if not section.head:
            continue
        assert any(rows == file[1:] for file in files), section.heading
        if section.printed:
            assert all(" ".join(filter(None, row)).split() in printed for row in rows)
        assert all(line.split() in printed for line in section.remarks)


def test_the_question_has_an_answer_and_the_print_has_it(finished):
    summary = finished.run.summary
    assert summary.question.endswith("?")
    assert summary.answer
    brief, whole = list(finished.run.lines()), set(finished.run.lines(details=True))
    head = [summary.question, *summary.answer[:SENTENCES]]
    assert brief[1 : 1 + len(head)] == head
    assert set(summary.answer) <= whole
    tables = [line for line in brief[1 + len(head) :] if "  " in line]
    assert all(len(line) <= WIDTH for line in tables)
    assert len(brief) < 30


def test_answers_are_shown_in_units_of_their_variables(finished):
    for stage, dataset in finished.stages:
        compared = stage.compared(dataset)
        have = [name for name in stage.answers if name in compared]
        assert bool(have) == bool(stage.answers)
        columns = answer_columns(have, {name: compared[name].values for name in have})
        for name, unit, scale in zip(
            have, columns["answer_unit"], columns["answer_scale"], strict=True
        ):
            chosen = SHOWN[name].in_unit(compared[name].values.ravel())
            assert (chosen.name, chosen.scale) == (unit, scale)


def test_printed_numbers_equal_the_dataset_in_the_unit_of_the_head():
    table = Table(("preload", "joint_stiffness", "contact_fraction"), answer="joint_stiffness")
    values = {"preload": [1e6, 2e6], "joint_stiffness": [1.5e13, 2e13]}
    values |= {"contact_fraction": [0.0125, 0.5], "converged": [1, 1]}
    data = MACRO_RESULT.build(values | dict.fromkeys(("residual", "wall_time"), np.zeros(2)))
    head, rows = table.rows(data)
    assert head == ("preload (MPa)", "joint stiffness (MPa/µm)", "contact (%)")
    for name, column in zip(values, zip(*rows, strict=True), strict=False):
        shown = unit_in(data, name).shown(data[name].values)
        np.testing.assert_allclose(np.array(column, dtype=float), shown, rtol=1e-3)

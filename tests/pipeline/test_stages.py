"""A case is made of stages, and only its file refers to a stage by name."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from multiscale.io import write_dataset
from multiscale.needs import Choice, Needs, join_needs
from multiscale.pipeline import load_case, load_sweep, requirements, run, stages
from multiscale.pipeline.stage import WIDTH, Section, Stage, fit_columns, format_table
from multiscale.pipeline.stages import STAGES, stages_of
from multiscale.plotting.figure import new_figure, save_figure
from multiscale.report import draw_figures, open_finished, write_report
from multiscale.schema import MICRO_RESPONSE, Schema, Variable

MEAN_PRESSURE = Schema(
    "mean_pressure", 1, {"mean_real_pressure": Variable(("step",), "Pa", "mean real pressure")}
)


def press(case, outcome, job):
    """Mean real pressure of the cells: nominal pressure over the share that touches."""
    response = outcome[MICRO_RESPONSE.name]
    share = response["contact_fraction"].mean("realisation").values
    values = {"mean_real_pressure": response["nominal_pressure"].values / share}
    result = MEAN_PRESSURE.build(values)
    write_dataset(result, job.out / "mean_pressure.nc", MEAN_PRESSURE)
    return result


def show(result, out):
    pressure = 1e-6 * result["mean_pressure"]["mean_real_pressure"].values
    yield Section("Mean real pressure", remarks=[f"At most {pressure.max():.4g} MPa."])


ADDED = Stage(
    schema=MEAN_PRESSURE,
    tables=("micro",),
    run=press,
    needs=lambda case: Needs(choices=(Choice("mean pressure", "of the spots that touch"),)),
    sections=show,
)


def test_the_tables_of_a_file_ask_for_its_stages():
    joint = ["micro_response", "interface_law", "macro_result"]
    controlled = [joint[0], "coarser_response", "control_response", *joint[1:]]
    for name, asked in (("ground_steel", controlled), ("tyre_on_road", joint)):
        (case,) = load_sweep(name).points
        assert [stage.name for stage in stages_of(case.tables)] == asked
    assert [stage.name for stage in stages_of({"slide"})] == ["sliding_response"]
    assert [stage.name for stage in stages_of({"micro"})] == joint[:2]
    assert [stage.name for stage in stages_of({"structure", "joint"})] == joint[2:]


@pytest.mark.slow
def test_a_stage_that_is_added_is_run_reported_and_shown(run_folder, tmp_path, monkeypatch):
    monkeypatch.setattr(stages, "STAGES", (*STAGES, ADDED))
    out = tmp_path / "out"
    shutil.copytree(run_folder, out)
    case = load_case(out / "case.toml")
    assert "mean pressure" in requirements(case).built
    results = run(case, out)
    assert list(results) == ["micro_response", "interface_law", "macro_result", "mean_pressure"]
    assert results["macro_result"] is results.macro_result
    finished = open_finished(out)
    response, added = (finished.datasets[name] for name in ("micro_response", "mean_pressure"))
    np.testing.assert_allclose(
        added["mean_real_pressure"] * response["contact_fraction"].mean("realisation"),
        response["nominal_pressure"],
        rtol=1e-12,
    )
    assert next(finished.lines(details=True)).startswith("At most ")
    page = write_report(out).read_text(encoding="utf-8")
    assert ">Mean real pressure</h2>" in page
    assert "How stiff is the joint of the two bodies" in page


@pytest.mark.slow
def test_figures_of_stages_that_are_not_asked_for_go_and_others_stay(run_folder, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(run_folder, out)
    figure = new_figure()
    figure.subplots()
    save_figure(figure, out / "figures" / "sliding.png")
    (out / "figures" / "my_own.png").write_bytes(b"")
    assert "sliding" not in {file.stem for file in draw_figures(out)}
    assert not (out / "figures" / "sliding.png").exists()
    assert (out / "figures" / "my_own.png").exists()


def test_needs_of_stages_are_joined_and_the_largest_memory_counts():
    choices = Choice("a", "why"), Choice("b", "why not", built=False), Choice("c", "too")
    need = Needs(1, "small strain", choices[:2], libraries=("x", "y"), memory=3)
    other = Needs(3, choices=choices[2:], fields=("gap",), libraries=("y",), memory=2)
    joined = replace(join_needs([need, other]), seconds=0.0)  # NaN equals nothing
    assert joined == Needs(
        3,
        "small strain",
        choices,
        fields=("gap",),
        libraries=("x", "y"),
        memory=3,
        seconds=0.0,
    )


def test_a_long_name_of_a_column_stands_in_two_lines():
    table = format_table("title", ("preload (MPa)", "mean law, 95 %"), [("5", "11.48 ... 11.87")])
    assert table == ["title", "preload", "  (MPa)   mean law, 95 %", "      5  11.48 ... 11.87"]


def test_a_terminal_shows_the_columns_that_fit_in_their_order():
    head = ("step", "wide", "wider", "slip")
    rows = [("1", "a" * 50, "b" * 60, "0.3"), ("2", "a", "b", "0.4")]
    shown = fit_columns(head, rows)
    assert shown == (("step", "wide", "slip"), [(row[0], row[1], row[3]) for row in rows])
    assert max(map(len, format_table("Table", *shown))) <= WIDTH
    assert fit_columns(("long",), [("a" * 200,)])[0] == ("long",)

"""Messages of the command line while it works."""

import re
import sys
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from time import sleep
from types import SimpleNamespace

import pytest
import typer

import multiscale
from multiscale import cli, printing
from multiscale.needs import readable_time
from tests.support import PORES, run_python, write_scene


def test_progress_gives_the_time_left_from_the_work_since_the_start(monkeypatch, capsys):
    clock = [0.0]
    monkeypatch.setattr(printing, "perf_counter", lambda: clock[0])
    with printing.shown_progress(
        verbose=False, quiet=False
    ) as tell:  # two were stored by another run
        for clock[0], finished in ((100.0, 2), (110.0, 3), (130.0, 5), (140.0, 6)):
            tell(finished, 6, "points")
        tell(0, 3, "steps")
    assert capsys.readouterr().err.splitlines() == [
        "2 of 6 points",
        "3 of 6 points, about 30 s left",
        "5 of 6 points, about 10 s left",
        "6 of 6 points",
        "0 of 3 steps",
    ]


@pytest.mark.parametrize("command", [["run"], ["damage"]])
def test_a_run_that_lacks_answers_shows_the_others_and_ends_with_status_1(
    command, monkeypatch, tmp_path, capsys
):
    finished = SimpleNamespace(
        cautions=["few"], lines=lambda **_: ["half"], failure="no other step"
    )
    monkeypatch.setattr("multiscale.pipeline.run", lambda case, out, **options: None)
    monkeypatch.setattr("multiscale.report.show_run", lambda out: finished)
    case = write_scene(tmp_path, PORES)
    monkeypatch.setattr(sys, "argv", ["multiscale", *command, str(case), "-o", str(tmp_path)])
    with pytest.raises(SystemExit, match="1"):
        cli.main()
    output = capsys.readouterr()
    assert output.out.splitlines()[0] == "half"
    assert output.err.splitlines()[-2:] == ["caution: few", "multiscale: Pores: no other step"]


def test_long_times_are_printed_in_minutes_hours_and_days():
    times = [readable_time(t) for t in (89.0, 600.0, 9000.0, 1.8e6)]
    assert times == ["89 s", "10 min", "2.5 h", "20.8 d"]


def interrupt(begun):
    with cli._working(Path("results"), 2, None, False, True) as (executor, _):
        begun.append(executor.submit(sleep, 600.0))
        while not begun[0].running():
            sleep(0.01)
        raise KeyboardInterrupt


def test_interrupted_workers_end_and_the_command_prints_how_to_go_on(capsys):
    begun = []
    with pytest.raises(typer.Exit) as ended:
        interrupt(begun)
    assert ended.value.exit_code == 130
    assert isinstance(begun[0].exception(), BrokenProcessPool)  # the job is not awaited
    assert "interrupted; finished jobs remain in results" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--version"], ["-h"], ["run", "-h"], ["cases"]])
def test_the_first_request_is_answered(arguments):
    done = run_python("from multiscale.__main__ import main; main()", *arguments)
    text = {"--version": multiscale.__version__, "cases": "bolted_lap"}.get(arguments[0], "Usage")
    assert text in done.stdout


def test_a_table_of_measurements_is_fitted_and_predicts(monkeypatch, tmp_path, capsys):
    """K = p / u_0: an exponential law, which two equal runs confirm."""
    rows = [f"{p},{p / 0.5},{run}" for run in "ab" for p in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)]
    file, law = tmp_path / "runs.csv", tmp_path / "law.nc"
    file.write_text("\n".join(["pressure (MPa),stiffness (MPa/um),specimen", *rows]))
    command = ["multiscale", "fit", str(file), "-o", str(law)]
    at = ["--family", "exponential", "--pressure", "3 MPa", "--pressure", "100 MPa"]
    monkeypatch.setattr(sys, "argv", [*command, *at])
    with pytest.raises(SystemExit, match="0"):
        cli.main()
    output, cautions = capsys.readouterr()
    rows = [line.split() for line in output.splitlines()]
    assert output.startswith("exponential: 2 specimens at 6 pressures, ")
    assert float(output.split(", ")[1].split()[0]) < 1e-6  # % error of the fit
    assert rows[3] == ["3", "6"]  # equal runs leave intervals without a width
    assert "100 MPa lie outside the data; the law extrapolates" in cautions
    assert law.exists()


def test_a_table_refuses_responses(monkeypatch, tmp_path, capsys):
    file = tmp_path / "runs.csv"
    file.write_text("pressure (MPa),stiffness (MPa/um)\n1,2\n")
    out = ["-o", str(tmp_path / "law.nc")]
    monkeypatch.setattr(sys, "argv", ["multiscale", "fit", str(file), *out, "--shear", "s.nc"])
    with pytest.raises(SystemExit, match="1"):
        cli.main()
    assert (
        "--shear, --sliding and --measured belong to a response, not to a table"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    ("pressures", "sentence"),
    [
        (1, "needs 3 pressures or more, got 1"),
        (2, "needs 3 pressures or more, got 2"),
        (3, "law: "),
    ],
)
def test_few_measurements_are_fitted_or_refused_in_a_sentence(
    pressures, sentence, monkeypatch, tmp_path, capsys
):
    rows = [f"{2.0**k},{3.0 * 1.5**k}" for k in range(pressures)]
    file = tmp_path / "runs.csv"
    file.write_text("\n".join(["pressure (MPa),stiffness (MPa/um)", *rows]))
    monkeypatch.setattr(
        sys, "argv", ["multiscale", "fit", str(file), "-o", str(tmp_path / "law.nc")]
    )
    with pytest.raises(SystemExit):
        cli.main()
    assert sentence in "".join(capsys.readouterr())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "option", "stages", "left_out"),
    [
        ("ground_steel", "--until=law", "micro_response", "macro_result"),
        ("porous_bracket", "--only=rve", "rve", "macro_result"),
    ],
)
def test_a_part_of_a_case_has_its_stages_only(command, case, option, stages, left_out):
    costs = [command("run", case, *more, "--explain")[1] for more in ((), (option,))]
    whole, part = (set(re.findall(r"cost of (\w+)", text)) for text in costs)
    assert stages in part <= whole
    assert left_out not in part


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--until", "law", "--only", "rve"], "--until, --from and --only exclude each other"),
        (["--law", "law.nc"], "--law is the law of the joints"),
        (["--from", "structure"], "the structure has joints but no law"),  # its cells are left out
        (["--only", "rve"], "the case has no [rve]"),
    ],
)
def test_a_part_that_a_case_has_not_is_refused(command, options, sentence):
    status, _, output = command("run", "ground_steel", *options)
    assert status == 1
    assert sentence in output

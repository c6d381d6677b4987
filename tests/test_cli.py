"""What the command line tells while it works."""

from pathlib import Path
from time import perf_counter, sleep

import pytest
import typer

import multiscale
from multiscale import cli
from multiscale.executors import workers
from multiscale.needs import say_time
from tests.support import run_python


def test_progress_tells_the_time_left_from_what_was_done_since_the_start(monkeypatch, capsys):
    clock = [0.0]
    monkeypatch.setattr(cli, "perf_counter", lambda: clock[0])
    with cli._shown(verbose=False, quiet=False) as tell:  # two were kept from another run
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


def test_long_times_are_told_in_minutes_hours_and_days():
    times = [say_time(t) for t in (89.0, 600.0, 9000.0, 1.8e6)]
    assert times == ["89 s", "10 min", "2.5 h", "20.8 d"]


def interrupt():
    with cli._resumable(Path("results")), workers(2, None) as executor:
        future = executor.submit(sleep, 600.0)
        while not future.running():
            sleep(0.01)
        raise KeyboardInterrupt


def test_interrupted_workers_end_and_the_command_says_how_to_go_on(capsys):
    begin = perf_counter()
    with pytest.raises(typer.Exit) as ended:
        interrupt()
    assert ended.value.exit_code == 130
    assert perf_counter() - begin < 60.0  # not the job's
    assert "interrupted; finished parts are kept in results" in capsys.readouterr().err


@pytest.mark.parametrize("arguments", [["--version"], ["-h"], ["run", "-h"], ["cases"]])
def test_what_is_asked_first_is_answered(arguments):
    done = run_python("from multiscale.__main__ import main; main()", *arguments)
    said = {"--version": multiscale.__version__, "cases": "bolted_lap"}.get(arguments[0], "Usage")
    assert said in done.stdout

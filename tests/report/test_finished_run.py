"""Figures of a finished run are all drawn, by whatever process."""

import sys

import pytest

from tests.support import run_python

PROGRAM = """
    import os
    import sys
    from pathlib import Path

    import multiscale.report.page as module
    from multiscale.pipeline.stage import Section

    def fail(file):
        raise ValueError(f"{file.stem} cannot be drawn")

    def write(file):
        file.write_text(str(os.getpid()))
        return file

    draw = {"fail": fail, "write": write}
    module.cores = lambda: int(sys.argv[2])
    out = Path(sys.argv[1])
    section = Section("figures", figures={f"{k}": draw[one] for k, one in enumerate(sys.argv[3:])})
    try:
        files = module.draw_sections(out, [section])
    except ValueError as error:
        sys.exit(str(error))
    print(*[file.stem for file in files])
    print(*[file.read_text() == str(os.getpid()) for file in files])
"""


@pytest.mark.parametrize("cores", [1, 2])
def test_two_processes_draw_figures_where_there_are_two_cores(tmp_path, cores):
    done = run_python(PROGRAM, tmp_path, cores, *["write"] * 3)
    alone = cores == 1 or sys.platform != "linux"
    assert done.stdout.split() == ["0", "1", "2", "True", str(alone), "True"]


@pytest.mark.parametrize("which", [0, 1])
def test_a_figure_that_cannot_be_drawn_is_reported_once(tmp_path, which):
    asked = ["write"] * 2
    asked[which] = "fail"
    done = run_python(PROGRAM, tmp_path, 2, *asked, check=False)
    assert done.returncode == 1
    assert done.stderr == f"{which} cannot be drawn\n"

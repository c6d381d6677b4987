"""Substructures over processes that mpiexec starts."""

import os
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

from multiscale.io import open_dataset
from multiscale.macro.substructures import world
from multiscale.schema import MACRO_RESULT

PROGRAM = dedent(
    """
    import sys
    import numpy as np
    from multiscale.macro import cut_links, solve_latin, tensegrity_grid
    from multiscale.macro.substructures import split_grid, world

    grid = tensegrity_grid(8, prestress=2550.0 / 4.0)
    problem = cut_links(grid, split_grid(grid, (4, 4)))
    result = solve_latin(problem, np.array([0.5, 1.0]), team=world())
    assert np.all(result.converged == 1)
    if world().rank == 0:
        print(world().size)
        np.save(sys.argv[1], result.tension.values)
    """
)


def test_the_answer_is_the_same_for_any_number_of_processes(tmp_path):
    pytest.importorskip("mpi4py")
    launcher = Path(sys.executable).with_name("mpiexec")
    if not launcher.exists():
        pytest.skip("mpiexec is not beside the interpreter")
    environment = dict(os.environ, OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    tensions = []
    for ranks in (1, 2, 4):
        file = tmp_path / f"{ranks}.npy"
        command = [str(launcher), "-n", str(ranks), sys.executable, "-c", PROGRAM, str(file)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)
        assert done.returncode == 0, done.stderr
        assert done.stdout.split() == [str(ranks)]
        tensions.append(np.load(file))
    scale = np.abs(tensions[0]).max()
    for tension in tensions[1:]:
        np.testing.assert_allclose(tension, tensions[0], rtol=0.0, atol=1e-10 * scale)


def test_the_command_spreads_a_scene_and_writes_it_once(tmp_path):
    pytest.importorskip("mpi4py")
    launcher = Path(sys.executable).with_name("mpiexec")
    if not launcher.exists():
        pytest.skip("mpiexec is not beside the interpreter")
    scene = tmp_path / "scene.toml"
    scene.write_text(
        'title = "grid"\n[structure]\nkind = "tensegrity_grid"\nn = 4\nprestress = "160 N"\n'
        "[substructures]\nparts = [2, 2]\n[statics]\nload_factors = [0.5, 1.0]\n"
    )
    tensions = []
    for ranks in (1, 2):
        out = tmp_path / f"{ranks}.nc"
        program = "from multiscale.cli import main; main()"
        command = [str(launcher), "-n", str(ranks), sys.executable, "-c", program]
        command += ["macro", str(scene), "-o", str(out)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, done.stderr
        assert done.stdout.count("dataset: ") == 1
        tensions.append(open_dataset(out, MACRO_RESULT)["tension"].values)
    scale = np.abs(tensions[0]).max()
    np.testing.assert_allclose(tensions[1], tensions[0], rtol=0.0, atol=1e-10 * scale)


def test_one_process_loads_nothing_of_mpi():
    program = "import sys; from multiscale.macro.substructures import world; world(); "
    program += "sys.exit('mpi4py' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0
    assert world().size == 1

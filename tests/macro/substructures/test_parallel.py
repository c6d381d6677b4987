"""Substructures over processes that mpiexec starts."""

import os
import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

from multiscale.errors import CaseError, MultiscaleError
from multiscale.io import open_dataset
from multiscale.macro.substructures import Alone, world
from multiscale.macro.substructures.stack import share, together
from multiscale.schema import MACRO_RESULT

PROGRAM = dedent(
    """
    import sys
    import numpy as np
    from multiscale.laws import Exponential, Sliders
    from multiscale.macro import LatinMethod, NewtonSchur, cut_links, solve_assembly
    from multiscale.macro import solve_latin, tensegrity_grid
    from multiscale.macro.substructures import split_grid, world
    from tests.cut_methods import solve_schur
    from tests.macro.substructures.test_bolts import sheared
    from tests.macro.substructures.test_schur import thin_plate
    from tests.macro.substructures.test_cut_joints import stacked_blocks

    team, solve = world(), {"latin": solve_latin, "schur": solve_schur}[sys.argv[2]]
    grid = tensegrity_grid(8, prestress=2550.0 / 4.0)
    law = Sliders(Exponential(1e9, 0.4e-6), 0.2, pressures=(1e6, 1e8))
    scenes = {
        "tension": (cut_links(grid, split_grid(grid, (4, 4))), np.array([0.5, 1.0])),
        "plate": (thin_plate(4), 1.0),
        "blocks": (stacked_blocks(law, 2, (1.0, 2.0, 3.0, 1.5)), np.eye(4)),  # two of them slip
    }
    found = {}
    for name, (problem, factors) in scenes.items():
        result = solve(problem, factors, team=team)
        assert np.all(result.converged == 1), name
        found[name] = result["tension" if name == "tension" else "displacement"].values
    method = {"latin": LatinMethod, "schur": NewtonSchur}[sys.argv[2]]((2, 1), team=team)
    path = np.array([[1.0, 0.0], [1.0, 2e6], [1.3, 2e6], [1.3, -1e6]])  # tightened twice
    bolted = solve_assembly(sheared(), path, method=method)
    assert np.all(bolted.converged == 1)
    found |= {name: bolted[name].values for name in ("bolt_force", "jump")}
    if team.rank == 0:
        print(team.size)
        np.savez(sys.argv[1], **found)
    """
)


@pytest.mark.long
@pytest.mark.parametrize("method", ["latin", "schur"])
def test_the_answer_is_the_same_for_any_number_of_processes(method, tmp_path):
    pytest.importorskip("mpi4py")
    launcher = Path(sys.executable).with_name("mpiexec")
    if not launcher.exists():
        pytest.skip("mpiexec is not beside the interpreter")
    environment = dict(os.environ, OMP_NUM_THREADS="1", MKL_NUM_THREADS="1")
    answers = []
    for ranks in (1, 2, 4):
        file = tmp_path / f"{ranks}.npz"
        command = [str(launcher), "-n", str(ranks), sys.executable, "-c", PROGRAM, str(file)]
        done = subprocess.run(
            [*command, method], capture_output=True, text=True, timeout=300, env=environment
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout.split() == [str(ranks)]
        answers.append(np.load(file))
    for name, value in answers[0].items():
        scale = np.abs(value).max()
        for answer in answers[1:]:
            np.testing.assert_allclose(answer[name], value, rtol=0.0, atol=1e-10 * scale)


def test_more_processes_than_substructures_are_refused():
    class Three(Alone):
        size = 3

    assert [len(share(3, Three())), len(share(2, Alone()))] == [1, 2]
    with pytest.raises(CaseError, match="3 processes cannot share 2 substructures"):
        share(2, Three())


def test_what_fails_in_one_process_raises_in_all():
    class Beside(Alone):
        def total(self, value):
            return value + 1.0  # the other one failed

    assert together(Alone(), lambda: 5) == 5
    with pytest.raises(MultiscaleError, match="failed in another process"):
        together(Beside(), lambda: 5)
    with pytest.raises(np.linalg.LinAlgError):
        together(Alone(), lambda: np.linalg.inv(np.zeros((2, 2))))


@pytest.mark.slow
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

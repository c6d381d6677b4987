"""Every family in its smallest form, and the known answers of its scenes."""

from importlib.util import find_spec

import numpy as np
import pytest

from multiscale.bench import FAMILIES, cell_scenes
from multiscale.bench.answers import DAMAGE_SCENES, WAVE_SCENES, life, wave_answer, wave_exact
from multiscale.bench.cell_scenes import LIMIT_SCENES, measure_kernel
from multiscale.bench.grain_scenes import BOUNCE, COMPLIANCES, EXACT, ROLL, STEPS, answer
from multiscale.bench.rough_contact import CODES
from multiscale.bench.structures import GRID_METHODS
from multiscale.bench.substructures import CUT_METHODS, RIGHT
from multiscale.io import open_dataset
from multiscale.schema import WORK_PRECISION

METHODS = {
    "micro": {name for name, code in CODES.items() if find_spec(code.module)},
    "structures": {n for n, m in GRID_METHODS.items() if not m.pardiso or find_spec("pypardiso")},
    "substructures": set(CUT_METHODS),
}
LARGEST = {
    "chain": 0.01,
    "damage": 0.03,
    "grains": 0.1,
    "laws": 0.2,
    "meshes": 0.3,
    "micro": 0.03,
    "strain": 0.25,
    "structures": 1e-9,
    "substructures": RIGHT,
    "volumes": 0.15,
}
"""Largest error of a family; the others have no errors, or errors of methods that fail."""
OPEN = ("micro", "nonsmooth")
"""Families with methods that may not converge, or codes that may not start."""
SEPARATE = "structures"
"""The family with a process for each run, as its methods choose the imports of a process; the
others are measured in the process of the test."""


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_the_smallest_form_of_a_family_leaves_a_dataset_and_a_figure(
    request, command, tmp_path, family
):
    if family != SEPARATE:
        request.getfixturevalue("in_this_process")
    status, output, _ = command("bench", family, "-o", tmp_path, "--quick")
    assert status == 0
    dataset = open_dataset(tmp_path / f"{family}.nc", WORK_PRECISION)
    methods = set(dataset["method"].values)
    assert methods == METHODS.get(family, methods)
    error, converged = dataset["error"].values, dataset["converged"].values == 1
    assert converged[dataset["method"].str.startswith("multiscale")].all()
    assert family in OPEN or converged.all()
    if family in LARGEST:
        assert np.isfinite(error[converged]).any()
        assert np.nanmax(error[converged]) < LARGEST[family]
    if family == SEPARATE:
        assert np.all(dataset["peak_memory"].values[converged] > 2e7)
    assert dataset.attrs["title"] in output
    assert "load of the machine" in output
    assert (tmp_path / f"{family}.png").stat().st_size > 1000


@pytest.mark.parametrize("scene", WAVE_SCENES)
def test_a_wave_has_the_answers_of_its_closed_forms(scene):
    coarse, fine = (abs(wave_answer(scene, n) / wave_exact(scene) - 1.0) for n in (16, 64))
    assert 5.0 * fine < coarse < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("scene", DAMAGE_SCENES)
def test_jumps_give_the_life_of_every_cycle_for_a_share_of_them(scene):
    every, followed = life(scene, None)
    lives, counts = np.array([life(scene, tolerance) for tolerance in (0.1, 0.01)]).T
    errors, shares = np.abs(lives / every - 1.0), counts / followed
    assert errors[1] < 1e-3
    assert errors[1] < errors[0] < 0.1
    assert shares[0] < shares[1] < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("scene", [BOUNCE, ROLL])
@pytest.mark.parametrize("compliance", COMPLIANCES.values())
def test_grains_follow_their_closed_forms_to_first_order_of_the_step(scene, compliance):
    errors = np.array([answer(scene, compliance, step) - EXACT[scene] for step in STEPS])
    order = np.log2(errors[:-1] / errors[1:])
    np.testing.assert_allclose(order, 1.0, atol=0.3)


@pytest.mark.parametrize("scene", LIMIT_SCENES)
def test_a_kernel_is_measured_with_a_copy_of_its_bytes(scene, monkeypatch):
    monkeypatch.setattr(cell_scenes, "LEAST", 1e-3)
    result = measure_kernel(scene, 34)
    assert min(result[name] for name in ("over_copy", "wall_time", "operations")) > 0.0
    arrays = 1 if scene == "compliance of a flat cell" else 3 * cell_scenes.LAYERS
    precision = 4 if scene.endswith("single precision") else 8
    assert result["bytes_moved"] >= 2 * precision * 34 * 34 * arrays  # in and out

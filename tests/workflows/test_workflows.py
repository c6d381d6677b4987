"""Every workflow and every scene runs, and leaves its promised files."""

import runpy
from pathlib import Path
from shutil import copytree
from xml.etree import ElementTree

import meshio
import pytest

from multiscale.io import open_dataset
from multiscale.pipeline import load_case, run_macro
from multiscale.pipeline.case import shipped_cases
from multiscale.pipeline.stages import stages_of
from multiscale.schema import GRANULATE, MACRO_RESULT

FOLDER = Path(__file__).parents[2] / "workflows"
SLOW = (
    *("damage_to_joint.py", "measured_joint.py", "ploughing.py", "roughness_sweep.py"),
    *("surfaces_to_joint.py", "bolted_cover.toml", "lap_joint.toml", "rough_blocks.toml"),
)
OTHERS = ("tensegrity_grid.py", "three_ways.py")
"""Scripts that separate tests run."""


def files(pattern):
    """Files of the workflows, those that take long marked as slow."""
    return [
        pytest.param(path, marks=[pytest.mark.slow] if path.name in SLOW else [], id=path.stem)
        for path in sorted(FOLDER.glob(pattern))
        if path.name not in OTHERS
    ]


@pytest.mark.slow
@pytest.mark.parametrize("script", files("*.py"))
def test_every_workflow_runs(script, tmp_path):
    main = runpy.run_path(str(script))["main"]
    assert not main(["--quick", "-o", str(tmp_path)])
    assert list(tmp_path.rglob("*.nc"))


@pytest.mark.parametrize(
    ("specimens", "sentence"),
    [
        (1, "the interval of the next specimen is unknown: there is a single specimen"),
        (2, "the mean law within 0.021 %, the next specimen within 0.037 %"),
    ],
)
def test_few_measured_specimens_have_a_law_with_students_intervals(
    specimens, sentence, tmp_path, capsys
):
    p = (1, 2, 4, 8, 16, 32)
    rows = [f"{x},{(3.0 + 1e-4 * k) * x**0.6},{k}" for k in range(specimens) for x in p]
    table = tmp_path / "runs.csv"
    table.write_text("\n".join(["pressure (MPa),stiffness (MPa/um),specimen", *rows]))
    main = runpy.run_path(str(FOLDER / "measured_stiffness.py"))["main"]
    assert not main(["--csv", str(table), "--quick", "-o", str(tmp_path)])
    assert sentence in capsys.readouterr().out


@pytest.mark.slow
def test_the_pictures_of_the_manual_are_made_anew(shipped_run, tmp_path):
    copytree(shipped_run("ground_steel")[0], tmp_path / "results" / "ground_steel")
    script = runpy.run_path(str(FOLDER / "manual" / "pictures.py"))
    names = ["ground_steel", "tensegrity_grid", "rough_blocks", "deposit"]
    assert not script["main"]([*names, "--quick", "-o", str(tmp_path)])
    made = {path.stem for path in (tmp_path / "workflows" / "figures").glob("*.png")}
    assert made == {"chain", "structures", *names}
    shipped = list((FOLDER / "figures").glob("*.png"))
    others = {"chain", "coverage", "joint", "structures"}  # of other scripts
    assert {path.stem for path in shipped} == {*others, *script["SHOWN"], *script["BENCHED"]}
    assert sum(path.stat().st_size for path in shipped) < 700e3


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_cases())
def test_every_shipped_case_runs(name, shipped_run):
    out, output, _ = shipped_run(name)
    assert f"report, figures and datasets: {out}" in output
    assert (out / "report.html").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.parametrize("scene", files("scenes/*.toml"))
def test_every_scene_runs(scene, shipped_run, tmp_path):
    """Scenes that name the law of a shipped case take it from its run, which other tests share."""
    settings, law = load_case(scene).quick(), None
    if settings.interface:
        law = shipped_run("ground_steel")[0] / "interface_law.nc"
    if settings.structure.kind == "lap_joint":
        pytest.importorskip("gmsh", exc_type=Exception)
    result = run_macro(settings, tmp_path / "macro_result.nc", law=law)
    assert result["converged"].values.all()
    schema = GRANULATE if "grain" in result.dims else MACRO_RESULT
    open_dataset(tmp_path / "macro_result.nc", schema)
    series = ElementTree.parse(tmp_path / "fields" / "macro_result.pvd")
    files = [tmp_path / "fields" / entry.get("file") for entry in series.iter("DataSet")]
    shown = result.sizes["frame" if "grain" in result.dims else "step"]
    assert len(files) == shown * (2 if settings.interface else 1)
    assert all(meshio.read(file).cells for file in files)
    stage, *_ = stages_of(settings.tables)
    answer = stage.summary(result).answer
    assert not any("steps converged" in sentence for sentence in answer)


def test_published_and_exact_values_are_met(tmp_path):
    script = runpy.run_path(str(FOLDER / "manual" / "published.py"))
    families = ("line_wave", "egg_box", "cubic_spheres", "grid_of_the_source")
    rows = [row for family in families for row in script[family]()]
    assert [row for row in rows if not abs(row[2] / row[1] - 1.0) < 0.015] == []
    page = (FOLDER / "published.md").read_text(encoding="utf-8")
    assert [what for what, *_ in rows if f"| {what} |" not in page] == []


@pytest.mark.slow
def test_the_grid_leaves_figures_and_a_series_for_each_part(tmp_path):
    main = runpy.run_path(str(FOLDER / "tensegrity_grid.py"))["main"]
    assert not main(["--quick", "-o", str(tmp_path)])
    for part, figure in (("static", "sorted_tensions"), ("unloading", "energies")):
        for name in (f"figures/{figure}.png", "figures/deformed_links.png"):
            assert (tmp_path / part / name).read_bytes().startswith(b"\x89PNG")
        assert (tmp_path / part / "fields" / "macro_result.pvd").is_file()

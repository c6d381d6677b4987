"""Every block of the manual runs as it stands, and its quotations are right."""

import re
import runpy
import shlex
import tomllib
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
import tifffile

from multiscale.cli import app
from multiscale.io import open_dataset, save_law
from multiscale.micro import self_affine
from multiscale.pipeline import load_case, load_sweep, run
from multiscale.pipeline.case import shipped_cases, validate_case
from multiscale.pipeline.tables.settings import Case
from multiscale.schema import MACRO_RESULT
from tests.support import case_of, small_steel

ROOT = Path(__file__).parents[1]
TOPICS = sorted((ROOT / "microcases" / "manual").glob("*.md"))
PAGES = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in (
        ROOT / "README.md",
        ROOT / "microcases" / "README.md",
        *TOPICS,
        ROOT / "workflows" / "README.md",
        *sorted((ROOT / "workflows").glob("*.md"))[1:],
        *sorted((ROOT / "workflows" / "site").rglob("*.md")),
    )
}
README, CASES = PAGES["README.md"], PAGES["microcases/README.md"]
KEYS = runpy.run_path(str(ROOT / "workflows" / "manual" / "keys.py"))
"""What writes the pages of keys."""
SLOW = ("run my_joint.toml -o", "micro my_joint", "damage scan.tif")
ELSEWHERE = (
    *(f"run {name}" for name in shipped_cases()),
    *("lap_joint.toml", "rough_blocks.toml", "bench micro", "stability", "workflows/site/build.py"),
)
"""Commands and scenes that other tests run: ``test_workflows``, ``test_families``,
``test_stability`` and ``.ci/run``."""


def blocks(language):
    """Blocks of a language by the heading above them, numbered where there are several."""
    results = {}
    for section in "".join(PAGES.values()).split("\n## ")[1:]:
        title, *parts = section.split(f"```{language}\n")
        for k, part in enumerate(parts):
            name = title.splitlines()[0] + (f", {k + 1}" if k else "")
            results[name] = part.split("```")[0]
    return results


def commands():
    """Command lines, each once, those that take long even if quick marked as slow."""
    lines = "".join(blocks("bash").values()).splitlines()
    results = [line.split(" && ")[-1].split("#")[0].strip() for line in lines]
    results = [line for line in results if "bin/multiscale" in line]  # others install
    # in sentences those that are whole, with their files
    within = re.findall(r"`(multiscale [^`]+)`", "".join(PAGES.values()))
    results += [line for line in within if re.search(r"\.\w|--help|cases", line)]
    for command in dict.fromkeys(results):
        if any(name in command for name in ELSEWHERE):
            continue
        slow = [pytest.mark.slow] if any(name in command for name in SLOW) else []
        yield pytest.param(command, marks=slow, id=command.removeprefix(".venv/bin/"))


def scan(file):
    """Heights of a rough surface of 0.8 mm."""
    surface = self_affine((64, 64), (8e-4, 8e-4), 1, short_cutoff=5e-5, rms_height=4e-7, **ROUGH)
    header = "Channel: Main\nWidth: 800 um\nHeight: 800 um\nValue units: m"
    np.savetxt(file, surface.heights, header=header)


def joint(file):
    """Case proposed for two maps."""
    files = [file.with_name(name) for name in ("scan.al3d", "scan_2.al3d")]
    for map_file in files:
        scan(map_file)
    options = ["--structure", "lap_joint", "--preload", "20 kN", "--case", str(file)]
    app(["inspect", *map(str, files), *options], standalone_mode=False)


def volume(file):
    """Image of a pore in a solid."""
    inside = np.square(np.indices((16,) * 3) - 7.5).sum(axis=0) < 25.0
    tifffile.imwrite(file, np.where(inside, 0, 255).astype(np.uint8))


def leaking_law(file):
    """Law of cells of which the manual asks for the apertures."""
    case = case_of(file.parent, small_steel(3).replace("[micro]", "[micro]\nleakage = true"))
    save_law(run(case.without_structure(), file.parent / "leaking").interface_law, file)


def measured(file):
    """Table of the stiffness of three specimens, a power of the pressure with a factor of each."""
    rows = [f"{p}, {k * p**0.8:.4f}, {k}" for k in (0.9, 1.0, 1.1) for p in (1, 2, 4, 8)]
    file.write_text("\n".join(["pressure (MPa), stiffness (MPa/um), specimen", *rows]))


MADE = {
    "scan.al3d": scan,
    "scan_2.al3d": scan,
    "joint.toml": joint,
    "scan.tif": volume,
    "interface_law.nc gap.csv": leaking_law,
    "stiffness.csv": measured,
}
"""Files of the user that commands in sentences take, and what makes such."""
ROUGH = {"hurst_exponent": 0.8, "long_cutoff": 2e-4}


@pytest.fixture
def folder(run_folder, tmp_path, monkeypatch):
    """A checkout after the main command, with the files that the manual shows."""
    monkeypatch.chdir(tmp_path)
    copytree(run_folder, "results")
    Path("workflows").symlink_to(ROOT / "workflows")
    whole = [text for text in blocks("toml").values() if text.startswith("title")]
    for name, text in zip(
        (f"{name}.toml" for name in ("my_joint", "pores", "lamp", "grid", "plate", "blocks")),
        whole,
        strict=True,
    ):
        Path(name).write_text(text, encoding="utf-8")
    for name, text in zip(("nodes.csv", "links.csv"), blocks("csv").values(), strict=True):
        Path(name).write_text(text, encoding="utf-8")
    return tmp_path


def test_the_block_of_python_runs(capsys):
    (block,) = blocks("python").values()
    names = {}
    exec(compile(block, "README.md", "exec"), names)
    assert np.all(np.diff(names["response"]["mean_gap"].mean("realisation")) < 0.0)
    assert names["law"].stiffness(names["law"].gap_at(20e6)) > 0.0


@pytest.mark.parametrize("command", list(commands()))
def test_a_command_runs_quickly(command, folder, monkeypatch):
    slow = any(name in command for name in (" run ", " micro ", " macro ", " damage "))
    quick = " --quick" if slow and "--quick" not in command else ""
    for name, make in MADE.items():
        if name in command and not ("inspect" in command and make is joint):
            make(folder / name.split()[0])
    for option in ("fit", "export", "--law"):  # files of the commands before it
        command = command.replace(f"{option} parts/", f"{option} results/")
    arguments = shlex.split(command + quick)
    app(arguments[1:], standalone_mode=False)
    if "-o" in arguments:
        assert (folder / arguments[arguments.index("-o") + 1]).exists()


def test_the_lamp_hangs_from_ropes_of_the_tension_of_its_polygon_of_forces(folder):
    app(["macro", "lamp.toml", "-o", "lamp.nc"], standalone_mode=False)
    tension = open_dataset("lamp.nc", MACRO_RESULT)["tension"].values
    np.testing.assert_allclose(tension[1], 50.0 * np.sqrt(5.0), rtol=1e-9)  # N, sine 1/sqrt(5)


@pytest.mark.parametrize("name", [k for k, t in blocks("toml").items() if "title" not in t])
def test_a_part_of_a_case_fits_into_the_whole_case(name, folder):
    whole = tomllib.loads(Path("my_joint.toml").read_text())
    piece = tomllib.loads(blocks("toml")[name])
    if "sweep" in piece:
        text = Path("my_joint.toml").read_text() + blocks("toml")[name]
        Path("sweep.toml").write_text(text)
        assert len(load_sweep("sweep.toml").points) == 6
        return
    if {"vibration", "fatigue"} & set(piece):
        whole = _joined(whole, tomllib.loads(blocks("toml")["Bodies from meshes"]))
    if "vibration" in piece:
        del whole["cycles"]
        for body in whole["structure"]["bodies"]:
            body["density"] = "7850 kg/m^3"
    validate_case(_joined(whole, piece), Path("my_joint.toml"))


def _joined(whole, piece):
    """A table with the keys of another put in, or replaced by a table of another kind.

    Loads of bodies take the place of preloads.
    """
    if {"file", "kind", "substeps", "load"} & set(piece):
        return piece
    return whole | {
        key: _joined(whole.get(key, {}), value) if isinstance(value, dict) else value
        for key, value in piece.items()
    }


def test_whole_files_are_read(folder):
    assert not [*load_case("my_joint.toml").cautions()]
    assert load_case("lamp.toml").structure.kind == "table"
    (taken,) = load_case("blocks.toml").structure.taken_laws(load_case("blocks.toml"))
    assert taken[0].name == "measured_law.nc"
    assert load_case("pores.toml").rve.recipe.realisations == 6


def test_the_tables_of_keys_agree_with_the_models():
    written = {path.name: PAGES[f"microcases/manual/{path.name}"] for path in TOPICS}
    pages = KEYS["key_pages"]()
    assert {name: written[name] for name in written if "keys_" in name} == pages, "run keys.py"
    assert KEYS["renew"](CASES) == CASES, "run python workflows/manual/keys.py"


def test_every_table_of_a_case_has_its_place_on_one_page():
    placed = [name for _, models in KEYS["PAGES"].values() for name in models.split()]
    tops = {top.__name__ for top, *_ in KEYS["_tables"](Case, ())}
    assert sorted(placed) == sorted(tops)


def test_every_key_is_explained():
    pages = "".join(KEYS["key_pages"]().values())
    rows = re.findall(r"^\| `(\w+)` \| .* \| (.*) \|$", pages, flags=re.MULTILINE)
    assert len(rows) > 150
    assert [key for key, meaning in rows if len(meaning.split()) < 2] == []


def test_pages_of_case_files_are_short_and_listed():
    assert [path.name for path in TOPICS if path.stat().st_size > 15e3] == []
    assert [path.name for path in TOPICS if f"(manual/{path.name})" not in CASES] == []
    shipped = (ROOT / "microcases").glob("*.toml")
    assert [path.name for path in shipped if f"({path.name})" not in CASES] == []


def test_sources_agree_with_the_docstrings():
    sources = PAGES["workflows/site/theory.md"].split("\n## Sources")[1]
    code = "".join(path.read_text() for path in (ROOT / "multiscale").rglob("*.py"))
    named = re.findall(r"doi:([^\s;|]+)", sources)
    assert len(named) >= 25
    assert [doi for doi in named if doi not in code] == []


def headings(page):
    """Anchors of the headings of a page."""
    return {
        re.sub(r"[^\w -]", "", line).replace(" ", "-").lower()
        for line in re.findall(r"^#+ (.*)$", page, flags=re.MULTILINE)
    }


@pytest.mark.parametrize("name", PAGES)
def test_links_and_figures_are_there(name):
    for target in re.findall(r"\]\(([^/)\s][^)\s]*)\)", PAGES[name]):  # the site checks others
        file, _, anchor = target.partition("#")
        path = (ROOT / name).parent / file if file else ROOT / name
        assert path.exists(), target
        if name.startswith("microcases/"):
            assert path.resolve().is_relative_to(ROOT / "microcases"), "installed without the rest"
        if anchor:
            assert anchor in headings(path.read_text(encoding="utf-8")), target


def test_the_readme_is_short_and_its_figures_are_small():
    assert len(README.splitlines()) <= 110
    figures = re.findall(r"!\[.*?\]\((.*?)\)", README)
    assert sum((ROOT / figure).stat().st_size for figure in figures) < 150e3
    assert len(figures) == 2


def test_every_guide_case_scene_and_script_is_in_the_manual():
    workflows, cases = ROOT / "workflows", ROOT / "microcases"
    gallery = PAGES["workflows/README.md"]
    assert [path for path in workflows.glob("guides/*.py") if path.name not in gallery] == []
    shown = [*cases.glob("*.toml"), *workflows.glob("scenes/*.toml"), *workflows.glob("*.py")]
    assert [path for path in shown if f"`{path.stem}`" not in gallery] == []

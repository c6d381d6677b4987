"""Importing the package is cheap: heavy libraries come with what needs them."""

import os
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

import multiscale
from tests.support import run_python

PACKAGE = Path(multiscale.__file__).parent
HEAVY = ("numba", "matplotlib", "gmsh", "skfem", "SurfaceTopography", "pint")


def modules_after(statement):
    code = f"import sys; {statement}; print('\\n'.join(sys.modules))"
    done = run_python(code)
    return set(done.stdout.split())


@pytest.mark.parametrize(
    "statement",
    [
        "import multiscale",
        "import multiscale.errors, multiscale.schema, multiscale.convergence",
        "import multiscale.laws, multiscale.io",
    ],
)
def test_importing_brings_no_heavy_library(statement):
    assert modules_after(statement).isdisjoint(HEAVY)


def test_importing_the_package_is_a_matter_of_milliseconds():
    # a count instead of a time, which imports determine
    extra = modules_after("import multiscale") - modules_after("pass")
    assert all(
        name.split(".")[0] in {"multiscale", "lazy_loader", "importlib", "types", "warnings"}
        for name in extra
    )


def test_a_report_that_verifies_nothing_needs_no_cells():
    call = "\nwith contextlib.suppress(c.MultiscaleError): c.report_command(p.Path('none'))\nc"
    loaded = modules_after(f"import contextlib, multiscale.cli as c, pathlib as p{call}")
    assert "multiscale.pipeline.run_folder" in loaded
    assert "multiscale.pipeline.verification" not in loaded


def test_the_command_line_is_explained_without_numpy():
    assert "numpy" not in modules_after("import multiscale.cli")


def test_cases_are_read_without_solvers_meshers_and_plots():
    loaded = modules_after("import multiscale.cli, multiscale as m; m.load_case('ground_steel')")
    late = {"scipy.fft", "scipy.ndimage", "scipy.optimize", "scipy.sparse", "scipy.special"}
    heavy = {
        "numba",
        "skfem",
        "gmsh",
        "meshio",
        "matplotlib",
        "SurfaceTopography",
        "pint",
        "xarray",
    }
    assert loaded.isdisjoint(heavy | late | {"urllib.request"})


def test_a_dataset_is_made_of_arrays_without_the_libraries_of_other_arrays():
    schema = "s.Schema('forces', 1, {'force': s.Variable(('step', 'component'), 'N', 'force')})"
    loaded = modules_after(
        f"import multiscale.schema.dataset_schema as s; {schema}.build({{'force': [[1.0, 2.0]]}})"
    )
    assert "xarray" in loaded
    assert loaded.isdisjoint({"pint", "dask.array"})


@pytest.mark.slow
@pytest.mark.parametrize(
    "program",
    [
        "c = d.Cavities((1.0, 1.0, 1.0), [d.spheres([[0.5, 0.5, 0.5]], 0.3)]); d.max_damage(c)",
        "d.two_scale_fatigue([210e6, -210e6], d.FatigueMaterial(2e11, 0.3, 2e8, 5e5))",
        "s = m.Surface([[0.0, 1e-3], [1e-3, 0.0]], (1.0, 1.0)); "
        "m.solve_cell(m.Cell(s, 1.0, 4, 1.0, 0.3, geometry='flat'), m.Path(pressure=(1e-4,)))",
    ],
    ids=["sections", "fatigue", "flat cell"],
)
def test_small_problems_are_solved_without_parts_of_scipy_that_they_do_not_need(program):
    """Each takes as long to load as the solution; the first process may have to compile."""
    program = f"import multiscale.micro as m, multiscale.micro.damage as d; {program}"
    loaded = modules_after(program)
    loaded = modules_after(program) if "scipy.sparse" in loaded else loaded
    assert {"numba", "xarray"} <= loaded
    assert loaded.isdisjoint({"scipy.optimize", "scipy.sparse"})


def refused_first(package, libraries=""):
    return run_python(f"""
        import sys{libraries}  # once, and not in each fork
        from tests.first_imports import refused
        sys.path.append(".")
        print(*refused({package!r}), sep="\\n")
    """).stdout.splitlines()


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs forks of a process")
def test_every_module_can_be_imported_first():
    """A worker imports first the module of the function that it calls."""
    libraries = ", numba, pydantic, scipy.sparse.linalg, skfem, xarray"
    assert "".join(refused_first("multiscale", libraries)) == ""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs forks of a process")
def test_a_module_with_an_import_that_fails_only_at_the_start_is_named(tmp_path, monkeypatch):
    texts = {
        "__init__": "",
        "early": "answer = 1; from ring.late import scale",
        "late": "from ring.early import answer; scale = 2",
        "user": "from ring.early import answer",
    }
    (tmp_path / "ring").mkdir()
    for name, text in texts.items():
        (tmp_path / "ring" / f"{name}.py").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    (line,) = refused_first("ring")
    assert line.startswith("ring.late: cannot import name 'scale' from partially initialized")


def test_the_package_offers_what_scripts_use_without_importing_it_first():
    for name in set(dir(multiscale)) - {"__citation__", "__version__"}:
        assert callable(getattr(multiscale, name))
    with pytest.raises(AttributeError, match="No multiscale attribute solve_cel"):
        _ = multiscale.solve_cel


@pytest.mark.parametrize("name", ["laws", "io", "micro", "pipeline", "surfaces"])
def test_public_modules_list_their_exports_and_nothing_else(name):
    module = import_module(f"multiscale.{name}")
    assert dir(module) == sorted(module.__all__)


@pytest.mark.parametrize("stub", sorted(PACKAGE.rglob("*.pyi")), ids=lambda stub: stub.parent.name)
def test_names_of_a_lazy_package_are_imported_when_used_and_hidden_by_no_module(stub):
    package = ".".join(stub.parent.relative_to(PACKAGE.parent).parts)
    module = import_module(package)
    hidden = {file.stem for file in stub.parent.iterdir() if file.suffix == ".py"}
    assert set(dir(module)).isdisjoint(hidden)
    assert [name for name in dir(module) if not hasattr(module, name)] == []
    inside = {name for name in modules_after(f"import {package}") if name.startswith("multiscale.")}
    parents = {package[:k] for k, letter in enumerate(package) if letter == "."}
    assert inside <= {package, *parents}
    with pytest.raises(AttributeError, match=f"No {package} attribute no_such_name"):
        _ = module.no_such_name


def test_the_distribution_has_the_version_of_the_package_and_its_types():
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    assert tomllib.loads(text)["project"]["version"] == multiscale.__version__
    assert Path(multiscale.__file__).with_name("py.typed").exists()
    assert multiscale.__version__ in multiscale.__citation__

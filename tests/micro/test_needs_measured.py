"""Statements of --explain on each kind of cell, against a process that solves a cell."""

import json

import pytest

from tests.support import run_python

CODE = """
import json, sys
from pathlib import Path as File
import numba
from multiscale.laws.bulk import Elastic
from multiscale.micro import Cell, Path, solve_cell
from multiscale.surfaces import self_affine

def peak():
    lines = File("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("VmHWM"))

def cell(n, layers):
    waves = dict(long_cutoff=0.5, short_cutoff=0.25)
    surface = self_affine((n, n), (1.0, 1.0), 2, rms_slope=0.1, hurst_exponent=0.8, **waves)
    {make}

solve_cell(cell(12, 4), Path(pressure=({pressure},)))  # imports and compiles
File("/proc/self/clear_refs").write_text("5")  # the peak begins anew, without the compiler's
before = peak()
whole = cell({n}, {layers})
solved = solve_cell(whole, Path(pressure=({pressure},)))
assert solved["converged"].values.all()
needs = whole.needs()
found = dict(stated=needs.memory, taken=peak() - before, libraries=list(needs.libraries))
print(json.dumps(found | dict(modules=list(sys.modules))))
"""

MESH = (
    "from multiscale.micro.mesh.meshing import ElementKind, graph_mesh_cell; "
    "return graph_mesh_cell(surface, 1.0, layers, {law}, ElementKind('{element}'){more})"
)
ELASTIC = "Elastic(1.0, 0.3)"
HEAVY = {"skfem", "meshio", "gmsh", "pyamg", "matplotlib", "pydantic"}
NAMES = {"scikit-fem": "skfem"}


def plain(**more):
    settings = "".join(f", {name}={value}" for name, value in more.items())
    return f"return Cell(surface, 1.0, layers, 1.0, 0.3{settings})"


def mesh(element="hex8", law=ELASTIC, more=""):
    return MESH.format(element=element, law=law, more=more)


KINDS = [
    pytest.param(plain(geometry="'flat'"), 256, 10, id="flat"),
    pytest.param(plain(), 96, 10, id="conforming"),
    pytest.param(mesh(), 24, 8, id="mesh"),
    pytest.param(mesh("tet10"), 24, 8, id="tet10"),
    pytest.param(mesh("hex27"), 16, 8, id="hex27"),
    pytest.param(mesh(), 40, 8, id="multigrid"),
    pytest.param(mesh(more=", friction_coefficient=0.3"), 16, 8, id="rubbing mesh"),
]
KINDS[1:] = [pytest.param(*kind.values, id=kind.id, marks=pytest.mark.slow) for kind in KINDS[1:]]


@pytest.mark.slow
@pytest.mark.parametrize(("make", "n", "layers"), KINDS)
def test_a_cell_takes_the_memory_and_the_libraries_that_it_states(make, n, layers):
    code = CODE.format(make=make, n=n, layers=layers, pressure=0.002)
    for _ in range(2):  # the first process may compile kernels of the larger cell
        computed = json.loads(run_python(code).stdout.splitlines()[-1])
        memory, taken = computed["stated"], computed["taken"]
        if taken < 2.0 * memory:
            break
    assert memory / 2.0 < taken < 2.0 * memory
    loaded = {name.partition(".")[0] for name in computed["modules"]}
    stated = {NAMES.get(name, name) for name in computed["libraries"]}
    assert stated <= loaded
    assert HEAVY & loaded <= stated
    finite = "multiscale.micro.finite.equations" in computed["modules"]
    assert finite == ("friction" in make)

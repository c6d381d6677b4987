"""What several tests need."""

import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from textwrap import dedent

import meshio
import numpy as np
import pytest

from multiscale.fe.faces import face_of
from multiscale.fe.mesh_file import HEX_ORDER
from multiscale.io import open_law, save_law
from multiscale.micro import Cell, Surface, run_ensemble, self_affine
from multiscale.micro import Path as PressurePath
from multiscale.pipeline import load_case
from multiscale.pipeline.case import shipped_cases
from multiscale.upscaling import fit_law
from tests.upscaling.responses import response_of


def slow(*values):
    """Values of a parameter that only the slow tests take."""
    return [pytest.param(value, marks=pytest.mark.slow) for value in values]


def observed_rate(sizes, errors):
    """Slope of log error against log size, by least squares."""
    return float(np.polyfit(np.log(sizes), np.log(np.abs(errors)), 1)[0])


def alart_curnier(velocity, reaction, friction, step=1.0):
    """Residual of Coulomb's law after Alart and Curnier: normal and tangent apart."""
    ahead = reaction - step * velocity
    normal = np.maximum(ahead[0], 0.0)
    size = np.linalg.norm(ahead[1:], axis=0)
    tangent = ahead[1:] * np.minimum(1.0, friction * normal / np.where(size > 0.0, size, 1.0))
    return reaction - np.concatenate([normal[None], tangent])


def wave(points, amplitude):
    """A cosine along x with wavelength 1 m, uniform along y."""
    nx, ny = points
    x = 2.0 * np.pi * np.arange(nx) / nx
    return Surface(np.tile(amplitude * np.cos(x)[:, None], (1, ny)), (1.0, ny / nx))


def egg_box(n, amplitude):
    """Product of two cosines with wavelength 1 m."""
    x = np.cos(2.0 * np.pi * np.arange(n) / n)
    return Surface(amplitude * np.outer(x, x), (1.0, 1.0))


def rough_square(points, long_cutoff, short_cutoff, rms_slope, *, seed=0, size=1.0, hurst=0.8):
    """A self-affine surface of a square cell."""
    return self_affine(
        (points, points),
        (size, size),
        seed,
        hurst_exponent=hurst,
        long_cutoff=long_cutoff,
        short_cutoff=short_cutoff,
        rms_slope=rms_slope,
    )


def flat_cell(surface, modulus=0.91, poissons_ratio=0.3):
    """A flat cell as deep as it is long; its contact modulus is 1 if no modulus is given."""
    return Cell(surface, surface.size[0], 8, modulus, poissons_ratio, geometry="flat")


def press_flat(surfaces, pressures, *moduli, **options):
    """Response of flat cells at pressures."""
    cells = [flat_cell(surface, *moduli) for surface in surfaces]
    return run_ensemble(cells, PressurePath(pressure=tuple(pressures)), **options)


def flat(points):
    """A plane of 1 m by 1 m."""
    return Surface(np.zeros((points, points)), (1.0, 1.0))


def sphere(points, radius):
    """A paraboloid as the obstacle of a flat body."""
    x = (np.arange(points) - points // 2) / points
    return Surface((x[:, None] ** 2 + x**2) / (2.0 * radius), (1.0, 1.0))


COMMAND = "from multiscale.cli import main; main()"
"""Program of the command line."""


SCENES = Path(__file__).parents[1] / "workflows" / "scenes"


def text_of(file):
    """Text of a file in the folder ``cases``."""
    return (Path(__file__).parent / "cases" / file).read_text(encoding="utf-8")


def case_text(name):
    """Text of a case, after an empty line."""
    return "\n" + text_of(f"{name}.toml")


TWO_BLOCKS = case_text("two_blocks")
PORES = """
title = "Pores"
[rve]
youngs_modulus = "70 GPa"
poissons_ratio = 0.3
size = "1 mm"
[rve.recipe]
porosity = 0.1
pore_radius = "0.2 mm"
"""


def run_python(program, *arguments, check=True, **options):
    """Run a program in a separate process, and return its output and its status."""
    command = [sys.executable, "-c", dedent(program), *map(str, arguments)]
    options = {"timeout": 600} | options
    return subprocess.run(command, capture_output=True, text=True, check=check, **options)


def steel_text():
    """Text of the case of ground steel without the cells on half of the points.

    Targets and maps exclude these.
    """
    text = shipped_cases()["ground_steel"].read_text(encoding="utf-8")
    return re.sub("coarser = .*\n", "", text)


def small_steel(realisations, more=""):
    """Text of the case of ground steel with flat cells of 36 by 36 points."""
    text = steel_text().replace("[128, 128]", "[36, 36]")
    text = text.replace("layers = 14", 'layers = 14\ngeometry = "flat"')
    return text.replace("realisations = 5", f"realisations = {realisations}") + more


def write_scene(folder, text, *pairs):
    """Write a scene or case with some text replaced, and return its path."""
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1) if old else text + new
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def refused_rows(*bases):
    """Rows of refused cases of some base texts: base, patches (old, new), and the sentence."""
    file = Path(__file__).parent / "pipeline" / "refused.toml"
    tables = tomllib.loads(file.read_text(encoding="utf-8"))
    rows = []
    for base in bases:
        for name, (*patches, sentence) in tables[base].items():
            pairs = [patch.replace("\\n", "\n").split(" -> ", 1) for patch in patches]
            rows.append(pytest.param(base, pairs, sentence, id=f"{base}: {name}"))
    return rows


def case_of(folder, text, *pairs):
    """The case that a text describes, with some of it replaced."""
    return load_case(write_scene(folder, text, *pairs))


def write_law(path, pressure=(1e6, 200e6)):
    """Write the law fitted to exponential data between two pressures, and return its path."""
    p = np.geomspace(*pressure, 9)
    gap, area = 0.2e-6 * np.log(2e9 / p)[None], p[None] / 5e9
    save_law(fit_law(response_of(gap, p, area=area, nominal=False)), path)
    return path


def keep_ignoring_broken_pipes():
    """Undo what gmsh.initialize does: afterwards the death of a worker would end all tests."""
    signal.signal(signal.SIGPIPE, signal.SIG_IGN)


def write_body(path, mesh, *, scale=1e3, names=None, volume="solid"):
    """Write a mesh with its named faces as a text file of gmsh; mm if not given."""
    kind, facet, corners = "tetra", "triangle", mesh.t
    if mesh.t.shape[0] == 8:
        kind, facet, corners = "hexahedron", "quad", np.empty_like(mesh.t)
        corners[HEX_ORDER] = mesh.t
    blocks, tags, groups = [(kind, corners.T)], [[1] * corners.shape[1]], {volume: [1, 3]}
    for tag, name in enumerate(sorted(mesh.boundaries) if names is None else names, start=2):
        face = face_of(mesh, name)
        blocks.append((facet, face.nodes[face.facets]))
        tags.append([tag] * len(face.facets))
        groups[name] = [tag, 2]
    data = [np.array(entry) for entry in tags]
    meshio.Mesh(
        scale * mesh.p.T,
        blocks,
        cell_data={"gmsh:physical": data, "gmsh:geometrical": data},
        field_data={name: np.array(value) for name, value in groups.items()},
    ).write(path, file_format="gmsh22", binary=False)


def joints_of(case, result=None):
    """Bodies of stacked blocks or a lap joint, and the law of every joint as these take it."""
    bodies = case.structure.for_solver(case)
    return bodies, bodies.read_laws(case, result or {}, lambda file, quick: open_law(file))

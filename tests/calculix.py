"""CalculiX next to the package: a mark for tests that need it, and a run."""

import os
import subprocess
from shutil import which

import numpy as np
import pytest

needs_calculix = pytest.mark.skipif(which("ccx") is None, reason="CalculiX (ccx) is not installed")


def run_calculix(folder, lines):
    """Run an input deck on one thread, and return the text of its tables."""
    (folder / "deck.inp").write_text("\n".join([*lines, ""]), encoding="ascii")
    threads = os.environ | {"OMP_NUM_THREADS": "1"}
    call = ["ccx", "-i", "deck"]
    subprocess.run(call, cwd=folder, capture_output=True, check=True, env=threads, timeout=900)
    return (folder / "deck.dat").read_text()


def write_body(mesh, number, kind, places, elements, faces, first, joint):
    """Lines of one body of steel, its surface JOINT, and its named facets as element and side.

    Places of the nodes in mm, nodes of the elements, corners of their sides S1, S2 ..., and the
    numbers of the first node and element.
    """
    node, element = first
    lines = [f"*NODE, NSET=N{number}"]
    lines += [f"{i}, {x:.12g}, {y:.12g}, {z:.12g}" for i, (x, y, z) in enumerate(places, node)]
    lines += [f"*ELEMENT, TYPE={kind}, ELSET=E{number}"]
    lines += [", ".join(map(str, (i, *row))) for i, row in enumerate(elements + node, element)]
    lines += [f"*SOLID SECTION, ELSET=E{number}, MATERIAL=STEEL"]
    sides, facets = np.sort(elements[:, faces], axis=2).tolist(), {}
    for name, boundary in mesh.boundaries.items():
        wanted = set(map(tuple, np.sort(mesh.facets[:, boundary].T).tolist()))
        facets[name] = [
            (e, s)
            for e, row in enumerate(sides, element)
            for s, side in enumerate(row, 1)
            if tuple(side) in wanted
        ]
    lines += [f"*SURFACE, NAME=JOINT{number}", *(f"{e}, S{s}" for e, s in facets[joint])]
    return lines, facets, (node + len(places), element + len(elements))

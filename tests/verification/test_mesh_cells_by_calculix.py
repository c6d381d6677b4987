"""Cells with overhang, inclusion and pore against CalculiX on the same mesh."""

import numpy as np
import pytest

from multiscale.laws.bulk import Elastic
from multiscale.micro import CellSides, Path, solve_cell
from multiscale.micro.mesh.mesh_cell import assemble_elastic_mesh
from multiscale.micro.mesh.meshing import ElementKind, cell_from_file
from tests.calculix import needs_calculix, run_calculix
from tests.voxels import write_voxels

pytestmark = [pytest.mark.slow, needs_calculix]

VTK = [0, 3, 6, 2, 1, 5, 7, 4]  # corners of a hexahedron of scikit-fem in the order of CalculiX

MATRIX, INCLUSION = Elastic(1.0, 0.3), Elastic(0.1, 0.2)
APPROACH = 0.05


def bumpy(points):
    """Lift the cap to a paraboloid, so that contact grows."""
    points = points.copy()
    high = points[:, 2] > 0.99
    points[high, 2] -= 0.3 * np.sum((points[high, :2] - 0.45) ** 2, axis=1)
    return points


def scene(kind, path):
    """Write the voxels of a cap with an overhang on a block, and name volumes."""
    filled = np.zeros((8, 8, 8), dtype=bool)
    filled[:, :, :4] = True
    filled[3:5, 3:5, 4:6] = True
    filled[1:7, 1:7, 6:] = True
    volumes = np.zeros(filled.shape, dtype=int)
    if kind == "inclusion":
        volumes[2:6, 2:6, 1:3] = 1
    else:
        volumes[0, 0, 0] = 1
    if kind == "pore":
        filled[2:6, 2:6, 1:3] = False
    write_voxels(path, filled, volumes, move=bumpy)
    return cell_from_file(
        path,
        MATRIX,
        ElementKind.HEX8,
        volumes={"matrix": MATRIX, "inclusion": INCLUSION},
        sides=CellSides.SLIDING,
    )


def deck(cell, moved):
    """Lines of the elastic problem in which contact nodes have the displacements along z given."""
    mesh, points = cell.mesh, cell.mesh.p
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{k + 1},{x:.9e},{y:.9e},{z:.9e}" for k, (x, y, z) in enumerate(points.T)]
    modulus = np.broadcast_to(cell.law.youngs_modulus, mesh.nelements)
    for name, law in (("MATRIX", MATRIX), ("INCLUSION", INCLUSION)):
        lines.append(f"*ELEMENT, TYPE=C3D8, ELSET={name}")
        for e in np.flatnonzero(modulus == law.youngs_modulus):
            lines.append(",".join(str(n) for n in [e + 1, *(mesh.t[VTK, e] + 1)]))
        lines += [
            f"*MATERIAL, NAME={name}",
            "*ELASTIC",
            f"{law.youngs_modulus},{law.poissons_ratio}",
        ]
        lines.append(f"*SOLID SECTION, ELSET={name}, MATERIAL={name}")
    lines += ["*STEP", "*STATIC", "*BOUNDARY"]
    for axis in range(2):
        for side in np.flatnonzero(np.isin(points[axis], (0.0, 1.0))):
            lines.append(f"{side + 1},{axis + 1},{axis + 1},0.")
    lines += [f"{n + 1},1,3,0." for n in np.flatnonzero(points[2] == 0.0)]
    lines += [f"{n + 1},3,3,{u:.12e}" for n, u in moved.items()]
    return [*lines, "*NODE PRINT, NSET=ALL", "U,RF", "*END STEP"]


def read_tables(sentence):
    """Displacements and reactions of all nodes, shape (nodes, 3)."""
    tables, rows = [], []
    for line in [*sentence.splitlines(), "end of tables"]:
        words = line.split()
        if len(words) == 4 and words[0].isdigit():
            rows.append([float(word) for word in words[1:]])
        elif rows and words:
            tables.append(np.array(rows))
            rows = []
    return tables


@pytest.mark.parametrize("kind", ["overhang", "inclusion", "pore"])
def test_calculix_finds_the_same_contact_forces(kind, tmp_path):
    cell = scene(kind, tmp_path / "rve.msh")
    mesh = assemble_elastic_mesh(cell)
    state = mesh.problem.solve(load=None, approach=APPROACH, start=None, tolerance=1e-10)
    force = -float(
        solve_cell(cell, Path(approach=(APPROACH,)), tolerance=1e-10)["traction"][0, 0, 0]
    )
    assert force == pytest.approx(state.force.sum(), rel=1e-8)
    points = mesh.basis.doflocs
    top = np.unique(cell.mesh.facets[:, cell.mesh.boundaries["top"]])
    gap = points[2, top].max() - points[2, top]
    fixed = {top[k]: gap[k] - APPROACH for k in np.flatnonzero(state.active)}
    assert 4 < len(fixed) < 49

    displacement, reaction = read_tables(run_calculix(tmp_path, deck(cell, fixed)))
    contact = -reaction[list(fixed), 2]
    assert contact.sum() == pytest.approx(force, rel=1e-5)
    np.testing.assert_allclose(contact, state.force[state.active], atol=1e-4 * contact.max())
    # so the other code's contact is contact: it pushes, and nothing else penetrates
    assert contact.min() > -1e-3 * contact.max()
    opening = gap - APPROACH - displacement[top, 2]
    assert opening.min() > -1e-3 * APPROACH

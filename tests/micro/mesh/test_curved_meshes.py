"""Meshes of second order in files: curved elements of gmsh keep their shape in a cell."""

import meshio
import numpy as np
import pytest
from skfem import Basis

from multiscale.errors import CaseError
from multiscale.fe.mesh_file import load_mesh
from multiscale.laws.bulk import Elastic
from multiscale.micro import Path, solve_cell
from multiscale.micro.mesh.meshing import ElementKind, cell_from_file
from tests.support import keep_ignoring_broken_pipes

STEEL = Elastic(1.0, 0.3)


@pytest.fixture(scope="module")
def annulus(tmp_path_factory, gmsh):
    """Return a function that meshes a quarter of a thick ring by gmsh, and gives the file."""

    def write(hexahedra, incomplete):
        file = tmp_path_factory.mktemp("gmsh") / "ring.msh"
        gmsh.initialize(["-v", "0"])
        keep_ignoring_broken_pipes()
        try:
            geo = gmsh.model.geo
            centre = geo.addPoint(0, 0, 0)
            a, b = geo.addPoint(1, 0, 0), geo.addPoint(2, 0, 0)
            line = geo.addLine(a, b)
            del centre
            (_, (_, face), *_) = geo.extrude(
                [(1, line)], 0, 0, 1, numElements=[2], recombine=hexahedra
            )[0:2]
            ring = geo.revolve(
                [(2, face)], 0, 0, 0, 0, 0, 1, 0.5 * np.pi, numElements=[4], recombine=hexahedra
            )
            geo.mesh.setTransfiniteCurve(line, 4)
            geo.synchronize()
            gmsh.model.addPhysicalGroup(3, [tag for dim, tag in ring if dim == 3])
            gmsh.model.addPhysicalGroup(2, [face], name="bottom")
            gmsh.model.addPhysicalGroup(2, [ring[0][1]], name="top")
            gmsh.option.setNumber("Mesh.SecondOrderIncomplete", incomplete)
            gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
            gmsh.model.mesh.generate(3)
            gmsh.model.mesh.setOrder(2)
            gmsh.write(str(file))
        finally:
            gmsh.finalize()
        return file

    return write


@pytest.mark.parametrize(
    ("hexahedra", "incomplete", "kind", "element"),
    [
        pytest.param(True, 1, "hexahedron20", ElementKind.HEX27, id="hex20"),
        pytest.param(True, 0, "hexahedron27", ElementKind.HEX27, id="hex27"),
        pytest.param(False, 0, "tetra10", ElementKind.TET10, id="tet10"),
    ],
)
def test_a_ring_of_gmsh_keeps_its_volume_and_names(annulus, hexahedra, incomplete, kind, element):
    file = annulus(hexahedra, incomplete)
    assert kind in {block.type for block in meshio.read(file).cells}
    mesh = load_mesh(file, curved=True)
    assert {"bottom", "top"} <= set(mesh.boundaries)
    basis = Basis(mesh, mesh.elem(), intorder=4)
    exact = 0.25 * np.pi * (2.0**2 - 1.0**2)
    np.testing.assert_allclose(np.sum(basis.dx), exact, rtol=2e-4)  # 2.6e-2 of straight edges
    assert np.all(np.asarray(basis.mapping.detDF(basis.X)) != 0.0)
    straight = load_mesh(file)
    assert straight.doflocs.shape[1] == mesh.nvertices, "bodies drop the nodes between the corners"
    chords = np.sum(Basis(straight, straight.elem(), intorder=4).dx)
    assert 0.96 * exact < chords < 0.99 * exact
    first = ElementKind.TET4 if element.simplex else ElementKind.HEX8
    with pytest.raises(CaseError, match=f"of second order, which an element '{first}' does not"):
        cell_from_file(file, STEEL, first)


@pytest.mark.parametrize("nodes", [20, 27])
def test_a_box_of_a_file_is_pressed_evenly(tmp_path, nodes):
    """Boxes of 20 and 27 nodes carry an even pressure evenly."""
    n = 2
    grid = np.stack(np.meshgrid(*(np.arange(2 * n + 1),) * 3, indexing="ij"), -1)
    points, number = grid.reshape(-1, 3) / (2.0 * n), np.arange((2 * n + 1) ** 3)
    number = number.reshape(grid.shape[:3])
    corner = np.array([(0, 0), (2, 0), (2, 2), (0, 2)])
    middle = np.array([(1, 0), (2, 1), (1, 2), (0, 1)])
    layer = [
        np.column_stack([xy, np.full(4, z)])
        for xy, z in ((corner, 0), (corner, 2), (middle, 0), (middle, 2), (corner, 1))
    ]
    faces = [(0, 1, 1), (2, 1, 1), (1, 0, 1), (1, 2, 1), (1, 1, 0), (1, 1, 2), (1, 1, 1)]
    local = np.vstack([*layer, faces])[:nodes]
    at = 2 * np.stack(np.meshgrid(*(np.arange(n),) * 3, indexing="ij"), -1).reshape(-1, 1, 3)
    cells = number[tuple(np.moveaxis(at + local, 2, 0))]
    plane = {"bottom": 0, "top": 2 * n}
    square = np.vstack([corner, middle, [(1, 1)]])[: 8 if nodes == 20 else 9]
    sides = 2 * np.stack(np.meshgrid(*(np.arange(n),) * 2, indexing="ij"), -1).reshape(-1, 1, 2)
    blocks, tags = [], []
    for k, z in enumerate(plane.values(), start=1):
        x, y = np.moveaxis(sides + square, 2, 0)
        blocks.append((f"quad{square.shape[0]}", number[x, y, z]))
        tags.append(np.full(len(sides), k))
    data = [*tags, np.full(len(cells), 9)]
    used, renumbered = np.unique(cells, return_inverse=True)
    new = np.full(number.size, -1)
    new[used] = np.arange(len(used))
    mesh = meshio.Mesh(
        points[used],
        [
            *((kind, new[block]) for kind, block in blocks),
            (f"hexahedron{nodes}", renumbered.reshape(cells.shape)),
        ],
        cell_data={"gmsh:physical": data, "gmsh:geometrical": data},
        field_data={name: np.array([k, 2]) for k, name in enumerate(plane, start=1)},
    )
    file = tmp_path / "box.msh"
    meshio.write(file, mesh, file_format="gmsh22", binary=False)
    cell = cell_from_file(file, STEEL, ElementKind.HEX27, points=(4, 4))
    response = solve_cell(cell, Path(approach=(0.01,)), keep_fields=True)
    stiffness = 0.7 / (1.3 * 0.4)  # uniaxial strain
    np.testing.assert_allclose(response["pressure"], 0.01 * stiffness, rtol=1e-9)

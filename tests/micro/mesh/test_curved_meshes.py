"""Meshes of second order in files: curved elements of gmsh keep their shape in a cell."""

import meshio
import numpy as np
import pytest
from skfem import Basis

from multiscale.errors import CaseError
from multiscale.fe.mesh_file import load_mesh
from multiscale.laws.bulk import Elastic
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

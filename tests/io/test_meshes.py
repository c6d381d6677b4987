"""Bodies and their named faces from mesh files of several programs."""

from itertools import pairwise

import h5py
import meshio
import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.fe.faces import face_of, facet_normals
from multiscale.fe.mesh_file import load_mesh
from multiscale.io.meshes import open_mesh
from tests.support import keep_ignoring_broken_pipes, text_of

CUBE = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float
)

DECK = text_of("deck.inp")


def deck(nodes=CUBE, text=DECK):
    """A deck with the nodes of the cube from 1 to 8."""
    rows = [f"{k}, " + ", ".join(f"{x:g}" for x in node) for k, node in enumerate(nodes, start=1)]
    return text.format(nodes="\n".join(rows))


def area_vector(mesh, name):
    """Sum of the outward area vectors of a named boundary, m²."""
    face = face_of(mesh, name)
    return face.normals.sum(axis=0)


def test_surfaces_and_node_sets_of_a_deck_name_faces(tmp_path):
    (tmp_path / "block.inp").write_text(deck())
    cube = load_mesh(tmp_path / "block.inp", volume="Cube")
    assert cube.nelements == 1
    np.testing.assert_allclose(area_vector(cube, "Roof"), [0.0, 0.0, 1.0])
    for floor in ("Feet", "Floor"):
        np.testing.assert_allclose(area_vector(cube, floor), [0.0, 0.0, -1.0])
    np.testing.assert_allclose(area_vector(cube, "Front and edge"), [0.0, -1.0, 0.0])
    assert len(cube.boundaries["AllOfCube"]) == len(cube.boundaries["All"]) == 6
    assert "Edge" not in cube.boundaries, "no face has both nodes only"
    assert not {"_Roof_S2", "Springs"} & set(cube.boundaries)

    # faces of the tetrahedron of nodes 5, 6, 7, 30 in the order of the manual
    tip = load_mesh(tmp_path / "block.inp", volume="Tip")
    p = np.array([CUBE[4], CUBE[5], CUBE[6], [0.5, 0.5, 3.0]])
    for k, corners in enumerate(((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)), start=1):
        area = np.linalg.norm(facet_normals(p[None, corners])[0])
        assert np.linalg.norm(area_vector(tip, f"Tip{k}")) == pytest.approx(area)


@pytest.mark.parametrize(
    ("label", "normal"),
    [
        *(("S1", (0, 0, -1)), ("S2", (0, 0, 1)), ("S3", (0, -1, 0))),
        *(("S4", (1, 0, 0)), ("S5", (0, 1, 0)), ("S6", (-1, 0, 0))),
    ],
)
def test_labels_of_the_faces_of_a_cube_point_outwards(tmp_path, label, normal):
    (tmp_path / "cube.inp").write_text(deck() + f"*SURFACE, NAME=Side\n1, {label}\n")
    cube = load_mesh(tmp_path / "cube.inp", volume="Cube")
    np.testing.assert_allclose(area_vector(cube, "Side"), normal, atol=1e-15)


def test_surfaces_of_a_deck_without_a_name_are_no_faces(tmp_path):
    nameless = "*SURFACE, TYPE=NODE\n1\n*SURFACE\n1, S1\n"
    (tmp_path / "block.inp").write_text(deck() + nameless)
    (tmp_path / "named.inp").write_text(deck())
    both = (load_mesh(tmp_path / f"{name}.inp", volume="Cube") for name in ("block", "named"))
    assert len({tuple(sorted(cube.boundaries)) for cube in both}) == 1


@pytest.mark.parametrize("entry", ["LID.1", "Part-1.Lid.1"])
def test_a_dot_in_a_name_of_a_set_is_not_read_as_an_element_number(tmp_path, entry):
    # element 1 is the cube: the set is the tetrahedron
    dotted = (
        f"*ELSET, ELSET=Part-1.Lid.1\n2\n*ELSET, ELSET=Lid.1\n2\n*SURFACE, NAME=Top\n{entry}, S1\n"
    )
    (tmp_path / "block.inp").write_text(deck() + dotted)
    top = area_vector(load_mesh(tmp_path / "block.inp", volume="Tip"), "Top")
    np.testing.assert_allclose(np.linalg.norm(top), 0.5)


def test_exponents_of_fortran_are_read(tmp_path):
    for name, text in (
        ("E", deck()),
        ("D", deck().replace("30, 0.5, 0.5, 3.", "30, 5D-1, .5d0, 3.")),
    ):
        (tmp_path / f"{name}.inp").write_text(text)
    results = [load_mesh(tmp_path / f"{name}.inp", volume="Tip").p for name in "ED"]
    np.testing.assert_array_equal(*results)


def test_a_deck_that_includes_itself_is_refused(tmp_path):
    (tmp_path / "block.inp").write_text(deck() + "*INCLUDE, INPUT=part.inp\n")
    (tmp_path / "part.inp").write_text("*INCLUDE, INPUT=block.inp\n")
    with pytest.raises(CaseError, match=r"block\.inp includes itself by \*INCLUDE"):
        load_mesh(tmp_path / "block.inp", volume="Cube")


def test_a_deck_includes_other_files_and_may_have_any_ending(tmp_path):
    nodes, marker, rest = deck().partition("*Element, type=C3D8R")
    (tmp_path / "nodes.txt").write_text(nodes)
    (tmp_path / "job.msh").write_text("*INCLUDE, INPUT=nodes.txt\n" + marker + rest)
    assert load_mesh(tmp_path / "job.msh", volume="Tip").nelements == 1


def test_a_mesh_with_two_kinds_of_solids_needs_a_volume(tmp_path):
    (tmp_path / "block.inp").write_text(deck())
    with pytest.raises(CaseError, match="1 tetra; give as volume one of Cube, Tip, "):
        load_mesh(tmp_path / "block.inp")
    with pytest.raises(CaseError, match=r"no volume 'Cap' is named.*kinds of elements hexa"):
        load_mesh(tmp_path / "block.inp", volume="Cap")
    named, kind = (load_mesh(tmp_path / "block.inp", volume=name) for name in ("Tip", "tetra"))
    np.testing.assert_array_equal(named.p, kind.p)
    assert sorted(named.boundaries) == sorted(kind.boundaries)


def test_a_face_selects_the_part_of_a_mesh_that_has_it(tmp_path):
    above = CUBE + np.array([0.0, 0.0, 2.0])
    top = "*Surface, name=Lid\n7, S2\n*Nset, nset=Seat\n51, 52, 53, 54\n"
    rows = "".join(f"{51 + k}, {x}, {y}, {z}\n" for k, (x, y, z) in enumerate(above))
    more = f"*Node\n{rows}*Element, type=C3D8\n7, {', '.join(str(51 + k) for k in range(8))}\n"
    (tmp_path / "pair.inp").write_text(deck() + more + top)
    for name in ("Lid", "Seat"):
        upper = load_mesh(tmp_path / "pair.inp", volume=name)
        np.testing.assert_allclose(upper.p.min(axis=1), [0.0, 0.0, 2.0])
        np.testing.assert_allclose(area_vector(upper, "Lid"), [0.0, 0.0, 1.0])
        assert set(upper.boundaries) == {"Lid", "Seat"}
    with pytest.raises(CaseError, match="got 1 hexahedron, 1 tetra"):
        load_mesh(tmp_path / "pair.inp", volume="Floor")


def test_wedges_next_to_the_elements_of_a_body_are_not_left_out(tmp_path):
    points = np.vstack([CUBE, [[2.0, 0.0, 0.0], [2.0, 0.0, 1.0]]])
    cells = [("hexahedron", [range(8)]), ("wedge", [[1, 8, 2, 5, 9, 6]])]
    meshio.Mesh(points, cells).write(tmp_path / "mixed.vtu")
    with pytest.raises(CaseError, match="got 1 hexahedron, 1 wedge; give as volume one of"):
        load_mesh(tmp_path / "mixed.vtu")
    assert load_mesh(tmp_path / "mixed.vtu", volume="hexahedron").nelements == 1
    with pytest.raises(CaseError, match=r"needs elements of one kind out of .* got 1 wedge"):
        load_mesh(tmp_path / "mixed.vtu", volume="wedge")


# --- files of gmsh and Salome ----------------------------------------------------------------


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    """Writer of a box 2 m x 1 m x 1 m in a format of gmsh, with faces at its ends along z."""
    gmsh = pytest.importorskip("gmsh", exc_type=Exception)
    folder = tmp_path_factory.mktemp("box")

    def write(ending, *, order=1, save_all=0, volume=True, version=4.1):
        file = folder / f"box-{order}-{save_all}-{version}{ending}"
        gmsh.initialize(interruptible=False)
        keep_ignoring_broken_pipes()
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            gmsh.model.occ.addBox(0.0, 0.0, 0.0, 2.0, 1.0, 1.0)
            gmsh.model.occ.synchronize()
            for _, tag in gmsh.model.getEntities(2):
                z = gmsh.model.occ.getCenterOfMass(2, tag)[2]
                if abs(z - 0.5) > 0.4:
                    gmsh.model.addPhysicalGroup(2, [tag], name="top" if z > 0.5 else "bottom")
            for name in ("body", "steel") if volume else ():  # one part in two groups
                gmsh.model.addPhysicalGroup(3, [1], name=name)
            gmsh.option.setNumber("Mesh.MshFileVersion", version)
            gmsh.option.setNumber("Mesh.MeshSizeMax", 1.0)
            gmsh.option.setNumber("Mesh.SaveAll", save_all)
            gmsh.model.mesh.generate(3)
            gmsh.model.mesh.setOrder(order)
            gmsh.write(str(file))
        finally:
            gmsh.finalize()
        return file

    return write


READ = [
    pytest.param(".msh", {}, id="msh"),
    pytest.param(".msh", {"version": 2.2}, id="msh-2.2"),
    pytest.param(".msh", {"save_all": 1, "volume": False}, id="msh-save-all"),
    pytest.param(".msh", {"order": 2, "save_all": 1}, id="msh-save-all-2"),
    *(
        pytest.param(ending, {"order": order}, id=f"{ending[1:]}-{order}")
        for ending in (".med", ".unv", ".inp", ".cgns")
        for order in (1, 2)
    ),
]


@pytest.mark.parametrize(("ending", "options"), READ)
def test_formats_of_gmsh_keep_the_names_of_faces(box, ending, options, capfd):
    mesh = load_mesh(box(ending, **options), scale=1e-3)
    for name, sign in (("bottom", -1.0), ("top", 1.0)):
        np.testing.assert_allclose(area_vector(mesh, name), [0.0, 0.0, 2e-6 * sign], atol=1e-18)
    volume = np.abs(np.linalg.det((mesh.p[:, mesh.t[1:]] - mesh.p[:, mesh.t[:1]]).T)).sum() / 6.0
    assert volume == pytest.approx(2e-9)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("ending", "message"),
    [
        (".stl", "triangles must lie in a plane .* mesh the volume that it bounds"),
        (".key", "cannot be read as a mesh: Could not deduce file format from path"),
        (".off", "cannot be read as a mesh: Expected the first line to be `OFF`"),
        (".bdf", r"meshio stops with RuntimeError \(.BEGIN BULK. statement not found\)"),
        (".dat", r"cannot be read as a mesh: meshio stops with AssertionError \(no reason given\)"),
        (".su2", r"cannot be read as a mesh: meshio stops with KeyError \(24\), so the file is"),
    ],
)
def test_a_refused_file_has_the_reason_of_its_reader(box, ending, message, capfd):
    with pytest.raises(CaseError, match=message):
        load_mesh(box(ending, order=2 if ending == ".su2" else 1))
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("ending", [".vtk", ".mesh"])
def test_a_format_without_names_is_read_without_boundaries(box, ending):
    assert not load_mesh(box(ending)).boundaries


@pytest.mark.parametrize("ending", [".msh", ".med", ".unv", ".cgns"])
@pytest.mark.parametrize("share", [0.03, 0.3, 0.6, 0.9])
def test_a_truncated_file_is_refused_in_a_sentence(box, ending, share, tmp_path, capfd):
    content = box(ending).read_bytes()
    file = tmp_path / f"half{ending}"
    file.write_bytes(content[: int(share * len(content))])
    with pytest.raises(CaseError, match=r"^[^\n]*cannot be read as a mesh: [^\n]*$"):
        load_mesh(file)
    assert capfd.readouterr() == ("", "")


def test_text_with_the_ending_of_gmsh_never_runs_as_its_script(tmp_path):
    made = tmp_path / "made.txt"
    (tmp_path / "script.msh").write_text(f'Printf("x") > "{made}";\n')
    with pytest.raises(CaseError, match="cannot be read as a mesh"):
        open_mesh(tmp_path / "script.msh")
    assert not made.exists()


def test_names_of_netgen_stand_apart_from_their_numbers(tmp_path):
    tags = {"netgen:index": [np.array([1, 2]), np.array([1])]}
    names = {"floor": [1, 2], "wall": [2, 2], "steel": [1, 3]}
    cells = [("triangle", [[0, 1, 3], [0, 1, 4]]), ("tetra", [[0, 1, 3, 4]])]
    data = {name: np.array(pair) for name, pair in names.items()}
    meshio.Mesh(CUBE, cells, cell_data=tags, field_data=data).write(tmp_path / "tip.vol")
    tip = load_mesh(tmp_path / "tip.vol")
    np.testing.assert_allclose(area_vector(tip, "floor"), [0.0, 0.0, -0.5])
    np.testing.assert_allclose(area_vector(tip, "wall"), [0.0, -0.5, 0.0])
    assert list(tip.subdomains) == ["steel"]


def med(file):
    """A cube in format MED, with families of faces and nodes."""
    top = np.array([4, 5, 6, 7])
    mesh = meshio.Mesh(
        CUBE,
        [("hexahedron", [range(8)]), ("quad", [top, [0, 1, 2, 3]])],
        point_data={"point_tags": np.array([1, 1, 2, 2, 0, 0, 0, 0])},
        cell_data={"cell_tags": [np.array([-1]), np.array([-2, -3])]},
    )
    mesh.cell_tags = {-1: ["cube"], -2: ["top", "ends"], -3: ["ends"]}
    mesh.point_tags = {1: ["feet", "heel"], 2: ["feet"]}
    mesh.write(file)
    return file


def test_groups_of_faces_and_of_nodes_of_salome_name_faces(tmp_path):
    mesh = load_mesh(med(tmp_path / "cube.med"), volume="cube")
    np.testing.assert_allclose(area_vector(mesh, "top"), [0.0, 0.0, 1.0])
    np.testing.assert_allclose(area_vector(mesh, "feet"), [0.0, 0.0, -1.0])
    assert len(mesh.boundaries["ends"]) == 2, "a group may be in several families"
    assert "heel" not in mesh.boundaries


def test_a_file_of_salome_that_lacks_an_attribute_is_a_sentence(tmp_path, capfd):
    file = med(tmp_path / "cube.med")
    with h5py.File(file, "r+") as content:
        del content["ENS_MAA/mesh"].attrs["ESP"]
    with pytest.raises(CaseError, match=r"cube.med cannot be read as a mesh: gmsh cannot process"):
        load_mesh(file)
    assert capfd.readouterr() == ("", "")


def test_an_element_with_a_node_that_is_not_there_is_refused(tmp_path):
    meshio.Mesh(CUBE[:4], [("tetra", [[0, 1, 2, 9]])]).write(tmp_path / "open.vtu")
    with pytest.raises(CaseError, match=r"element \(tetra\) has a node that the file does not"):
        load_mesh(tmp_path / "open.vtu")


def test_facets_of_a_group_outside_the_volume_are_left_out(tmp_path):
    z = np.linspace(0.0, 2.0, 3)
    points = np.vstack([[(x, y, h) for x, y in CUBE[:4, :2]] for h in z])
    layers = [[*range(4 * a, 4 * a + 4), *range(4 * b, 4 * b + 4)] for a, b in pairwise(range(3))]
    sides = [[a, a + 1, a + 5, a + 4] for a in (0, 4)]
    meshio.Mesh(
        points,
        [("hexahedron", layers), ("quad", sides)],
        cell_data={"gmsh:physical": [[1, 2], [3, 3]], "gmsh:geometrical": [[1, 2], [3, 3]]},
        field_data={"low": np.array([1, 3]), "high": np.array([2, 3]), "front": np.array([3, 2])},
    ).write(tmp_path / "stack.msh", file_format="gmsh22", binary=False)
    low = load_mesh(tmp_path / "stack.msh", volume="low")
    np.testing.assert_allclose(area_vector(low, "front"), [0.0, -1.0, 0.0])


# --- files of the field ----------------------------------------------------------------------

FIELD = [
    ("cont001i.med", "", {"CONT_BAS": 4, "CONT_HAUT": 4}),
    ("zzzz416a.med", "", {"base": 1, "face_1": 1, "ori": 1}),
    ("cont103b.med", "hexahedron", {"CONT_BAS": 49}),
    ("cont103b.med", "tetra", {"CONT_HAUT": 124}),
    ("cont001i.med", "CONT_BAS", {"CONT_BAS": 4}),
    ("cont103b.med", "CONT_HAUT", {"CONT_HAUT": 124}),
    ("ccx_friction1.inp", "Smast", {"Smast": 16, "Nfix": 16}),
    ("ccx_friction1.inp", "Sslav", {"Sslav": 16, "Nload": 16}),
    ("ccx_friction1.inp", "", {"Smast": 16, "Sslav": 16, "Nfix": 16, "Nload": 16}),
    ("box_saveall.msh", "", {"bottom": 118, "top": 118, "left": 68}),
    ("precice_flap_all.msh", "", {"Nall": 736}),
    ("m1528.inp", "", {"base": 2, "NodeSet1": 3}),
]


@pytest.mark.parametrize(("name", "volume", "faces"), FIELD)
def test_a_mesh_of_another_program_names_its_faces(reference_data, name, volume, faces):
    boundaries = load_mesh(reference_data / "field" / name, volume=volume).boundaries
    assert faces == {face: len(boundaries[face]) for face in faces}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("field/cont103b.med", r"got 343 hexahedron, 395 tetra; give as volume one of hexa"),
        ("field/dangling.inp", "element 1 has node 99, which the deck does not define"),
        ("field/law.inp", "the deck has no elements"),
        ("user/truncated.msh", "gmsh cannot process the mesh .Error: Could not read elements"),
    ],
)
def test_a_faulty_mesh_of_a_user_is_refused_with_its_reason(reference_data, name, message, capfd):
    with pytest.raises(CaseError, match=message):
        load_mesh(reference_data / name)
    assert capfd.readouterr() == ("", "")

"""Series of bodies and joints for ParaView: read back with another reader, checked by statics."""

from xml.etree import ElementTree

import meshio
import numpy as np
import pytest

from multiscale.errors import CaseError, SchemaError
from multiscale.fe.mesh_file import box_mesh
from multiscale.io.fields import write_body_fields
from multiscale.laws import Exponential, ModifiedLaw, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.macro import Assembly, Body, LatinMethod
from multiscale.macro.bodies import add_body_fields, stacked_blocks
from multiscale.macro.substructures import (
    cut_assembly,
    joint_path,
    load_joint,
    solve_latin,
)
from multiscale.schema import MACRO_RESULT

PRELOADS = (5e6, 10e6)
E, DAMAGE, NORMAL = 70e9, 0.3, Exponential(1e9, 0.2e-6, gap=0.1e-6)


def volumes(mesh):
    """Volume of boxes with corners in the order of VTK."""
    corner = mesh.points[mesh.cells_dict["hexahedron"]]
    edges = [corner[:, k] - corner[:, 0] for k in (1, 3, 4)]
    np.testing.assert_allclose(corner[:, 6] - corner[:, 0], sum(edges), atol=1e-12)
    np.testing.assert_allclose(corner[:, 2] - corner[:, 0], edges[0] + edges[1], atol=1e-12)
    return np.einsum("ei,ei->e", np.cross(edges[0], edges[1]), edges[2])


@pytest.fixture(scope="module")
def result():
    materials = [Elastic((1.0 - DAMAGE) * E, 0.0), Elastic(E, 0.0)]
    law = Sliders(ModifiedLaw(NORMAL, 0.5), 0.2, pressures=(1e6, 1e8))
    blocks = stacked_blocks((0.02, 0.02, 0.01), (2, 3, 2), materials, [law])
    loaded = load_joint(blocks, joint_path(PRELOADS), method=LatinMethod(parts=(2, 1)))
    return add_body_fields(loaded, blocks.bodies, damage=(DAMAGE, 0.0))


def test_blocks_in_uniaxial_stress_have_its_stress_and_energy_in_every_element(result, tmp_path):
    MACRO_RESULT.check(result)
    write_body_fields(result, tmp_path, name="blocks")
    for k, pressure in enumerate(PRELOADS):
        mesh = meshio.read(tmp_path / f"blocks-{k:04d}.vtu")
        np.testing.assert_array_equal(mesh.points, result["position"])
        np.testing.assert_array_equal(mesh.point_data["displacement"], result["displacement"][k])
        np.testing.assert_allclose(volumes(mesh), 0.02 * 0.02 * 0.01 / 12, rtol=1e-12)
        values = {name: value[0] for name, value in mesh.cell_data.items()}
        modulus = np.where(values["element_body"] == 0, (1.0 - DAMAGE) * E, E)
        np.testing.assert_allclose(values["equivalent_stress"], pressure, rtol=1e-6)
        np.testing.assert_allclose(values["energy_density"], pressure**2 / (2 * modulus), rtol=1e-6)
        np.testing.assert_array_equal(values["element_damage"], DAMAGE * (modulus < E))


def test_points_of_joints_have_gap_tractions_state_and_damage(result, tmp_path):
    collection = write_body_fields(result, tmp_path, name="blocks")
    entries = [entry.attrib for entry in ElementTree.parse(collection).iter("DataSet")]
    assert [entry["file"] for entry in entries] == [
        "blocks-0000.vtu",
        "blocks-joints-0000.vtu",
        "blocks-0001.vtu",
        "blocks-joints-0001.vtu",
    ]
    assert [entry["part"] for entry in entries] == ["0", "1", "0", "1"]
    for k, pressure in enumerate(PRELOADS):
        mesh = meshio.read(tmp_path / f"blocks-joints-{k:04d}.vtu")
        np.testing.assert_array_equal(mesh.points, result["point_position"])
        np.testing.assert_allclose(mesh.points[:, 2], 0.01, rtol=1e-12)
        np.testing.assert_allclose(mesh.point_data["pressure"], pressure, rtol=1e-6)
        np.testing.assert_allclose(mesh.point_data["shear"], 0.0, atol=1e-6 * pressure)
        gap = 0.2e-6 * np.log(0.5 * 1e9 / pressure)
        np.testing.assert_allclose(mesh.point_data["gap"], gap, rtol=1e-6)
        np.testing.assert_array_equal(mesh.point_data["contact_state"], 1.0)
        np.testing.assert_array_equal(mesh.point_data["damage"], 0.5)
        np.testing.assert_array_equal(mesh.point_data["joint"], 0)


def test_the_strain_energy_of_a_plate_is_half_the_work_of_its_load(tmp_path):
    clamped = (0.0, 0.0, 0.0)
    plate = Body(
        box_mesh((1.0, 1.0, 0.1), (6, 6, 2)),
        Elastic(70e9, 0.3),
        supports={"left": clamped, "right": clamped},
        tractions={"top": (0.0, 0.0, -1e3)},
    )
    problem = cut_assembly(Assembly((plate,)), (2, 2))
    solved = solve_latin(problem, np.array([1.0, 2.0]))
    result = add_body_fields(solved, [plate])
    write_body_fields(result, tmp_path)
    for step, factor in enumerate((1.0, 2.0)):
        mesh = meshio.read(tmp_path / f"bodies-{step:04d}.vtu")
        load = factor * problem.sum_up([part.load[:, 0] for part in problem.substructures])
        work = load @ problem.unknowns(solved["displacement"].values[step])
        energy = mesh.cell_data["energy_density"][0] @ volumes(mesh)
        assert energy == pytest.approx(0.5 * work, rel=1e-6)


def test_a_result_of_something_else_is_refused(result, tmp_path):
    with pytest.raises(SchemaError, match="has no corners: it is not a result of elastic bodies"):
        write_body_fields(result.drop_vars("corners"), tmp_path)
    other = stacked_blocks((0.02, 0.02, 0.01), (2, 2, 1), [Elastic(E, 0.0)] * 2, [NORMAL])
    with pytest.raises(CaseError, match="has 72 nodes and the bodies 36"):
        add_body_fields(result, other.bodies)

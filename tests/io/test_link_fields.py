"""Series of a structure for ParaView: read back with another reader, and whole or absent."""

import os
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest

from multiscale.errors import MultiscaleError, SchemaError
from multiscale.io.fields import write_link_fields
from multiscale.macro import simulate, solve_static, tensegrity_grid


@pytest.fixture(scope="module")
def result():
    return solve_static(tensegrity_grid(2), [0.0, 1.0, 40.0])


def test_every_step_holds_the_lines_with_their_values(result, tmp_path):
    write_link_fields(result, tmp_path, name="grid")
    assert float((result["slack"] > 0.0).sum()) > 0.0
    for k in range(3):
        mesh = meshio.read(tmp_path / f"grid-{k:04d}.vtu")
        np.testing.assert_array_equal(mesh.points, result["position"])
        np.testing.assert_array_equal(mesh.cells_dict["line"], result["ends"])
        for name in ("tension", "slack"):
            np.testing.assert_array_equal(mesh.cell_data[name][0], result[name][k])
        np.testing.assert_array_equal(mesh.point_data["displacement"], result["displacement"][k])


def entries(path):
    return [
        (float(entry.get("timestep")), entry.get("file"))
        for entry in ElementTree.parse(path).iter("DataSet")
    ]


def test_the_collection_names_every_file_at_its_load_factor_or_time(result, tmp_path):
    outcome = entries(write_link_fields(result, tmp_path, name="a & b"))
    assert outcome == [(0.0, "a & b-0000.vtu"), (1.0, "a & b-0001.vtu"), (40.0, "a & b-0002.vtu")]
    assert all((tmp_path / name).is_file() for _, name in outcome)
    motion = simulate(tensegrity_grid(2), np.array([0.0, 0.25, 0.5]), 1.0)
    assert [at for at, _ in entries(write_link_fields(motion, tmp_path))] == [0.0, 0.25, 0.5]


def test_load_factors_that_fall_are_numbered(tmp_path):
    there_and_back = solve_static(tensegrity_grid(1), [0.0, 1.0, 0.0])
    result = entries(write_link_fields(there_and_back, tmp_path))
    assert [at for at, _ in result] == [0.0, 1.0, 2.0]


def test_a_result_without_links_is_refused(result, tmp_path):
    with pytest.raises(
        SchemaError, match="the result has no ends: it is not a result of nodes and links"
    ):
        write_link_fields(result.drop_vars("ends"), tmp_path)
    with pytest.raises(SchemaError, match="dimensions"):
        write_link_fields(result.isel(step=0), tmp_path)


def test_a_disk_that_fills_up_leaves_no_collection(result, tmp_path, monkeypatch):
    synced = []

    def fsync(descriptor):
        synced.append(descriptor)
        if len(synced) == 3:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(MultiscaleError, match="free some space"):
        write_link_fields(result, tmp_path, name="grid")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["grid-0000.vtu", "grid-0001.vtu"]

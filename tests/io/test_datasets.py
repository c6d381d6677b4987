"""Datasets on disk: schema, version, provenance, damage, atomic writing."""

import errno
import os

import numpy as np
import pytest
import xarray as xr

from multiscale.errors import MultiscaleError, SchemaError
from multiscale.io import open_dataset, write_bytes, write_dataset
from multiscale.schema import FIELDS, INTERFACE_LAW, MICRO_RESPONSE, SCHEMAS, WORK_PRECISION
from multiscale.schema.dataset_schema import HOLDING, LOADING, UNLOADING, branch_of


@pytest.fixture
def response():
    cells = np.ones((2, 3))
    vectors = np.ones((2, 3, 3))
    names = [name for name, v in MICRO_RESPONSE.variables.items() if "component" not in v.dims]
    return MICRO_RESPONSE.build(
        dict.fromkeys(names, cells)
        | {"traction": vectors, "displacement_jump": vectors, "nominal_pressure": [1.0, 2.0, 3.0]}
        | {"branch": [0, 0, 0]}
    )


def full(schema):
    """All variables of a schema, two entries along every dimension."""
    sizes = dict.fromkeys(
        (dim for v in (schema.variables | schema.optional).values() for dim in v.dims), 2
    ) | {"component": 3}
    values = {
        name: (
            np.array(["a", "µ"])
            if name in ("method", "scene")
            else np.ones([sizes[dim] for dim in variable.dims])
        )
        for name, variable in (schema.variables | schema.optional).items()
    }
    return schema.build(values, title="all of it")


@pytest.mark.parametrize("schema", SCHEMAS.values(), ids=SCHEMAS)
def test_every_schema_can_be_built_with_its_units(schema):
    built = full(schema)
    schema.check(built)
    for name, variable in (schema.variables | schema.optional).items():
        assert built[name].attrs["units"] == variable.units


@pytest.mark.parametrize("schema", [FIELDS, MICRO_RESPONSE, WORK_PRECISION], ids=lambda s: s.name)
def test_a_dataset_round_trips(schema, tmp_path):
    written = full(schema)
    write_dataset(written, tmp_path / "d.nc", schema)
    read = open_dataset(tmp_path / "d.nc", schema)
    xr.testing.assert_equal(read, written)
    plain = xr.load_dataset(tmp_path / "d.nc", engine="h5netcdf")
    xr.testing.assert_identical(read, plain)
    assert read.encoding["source"] == plain.encoding["source"]


def test_a_file_states_its_origin(response, tmp_path):
    write_dataset(response, tmp_path / "r.nc", MICRO_RESPONSE, identity="abc")
    attrs = open_dataset(tmp_path / "r.nc").attrs
    assert attrs["schema"] == "micro_response"
    assert attrs["identity"] == "abc"
    assert attrs["source"].startswith("multiscale ")
    assert f"numpy {np.__version__}, " in attrs["environment"]
    assert {"history", "Conventions", "schema_version"} <= set(attrs)


def test_every_fault_of_a_dataset_is_listed(response):
    response["mean_gap"].attrs["units"] = "um"
    with pytest.raises(SchemaError) as caught:
        MICRO_RESPONSE.check(response.drop_vars("traction").transpose("step", ...))
    message = str(caught.value)
    assert "not a 'micro_response' dataset (schema version 2)" in message
    assert "traction: missing; add it (averaged traction, eqs (2)-(3), Pa, dimensions" in message
    assert "mean_gap: units 'um', expected 'm'" in message
    assert "converged: dimensions ('step', 'realisation')" in message


def test_a_variable_that_is_gone_is_refused_with_its_remedy():
    law = INTERFACE_LAW.build({"fit_pressure": [1e6]}).assign(interface_damage=0.2)
    with pytest.raises(SchemaError, match="interface_damage: not supported any more; fit the law"):
        INTERFACE_LAW.check(law)


def test_another_schema_version_is_refused_with_both_named(response, tmp_path):
    file = tmp_path / "r.nc"
    response.assign_attrs(schema="micro_response", schema_version=7).to_netcdf(
        file, engine="h5netcdf"
    )
    with pytest.raises(SchemaError, match=r"of schema version 7, this package reads version 2"):
        open_dataset(file, MICRO_RESPONSE)


def test_another_kind_of_dataset_is_refused(response, tmp_path):
    write_dataset(response, tmp_path / "r.nc", MICRO_RESPONSE)
    with pytest.raises(SchemaError, match="schema 'micro_response', expected a 'fields' dataset"):
        open_dataset(tmp_path / "r.nc", FIELDS)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.95])
def test_a_truncated_file_is_refused(response, tmp_path, share):
    whole = tmp_path / "r.nc"
    write_dataset(response, whole, MICRO_RESPONSE)
    content = whole.read_bytes()
    cut = tmp_path / "cut.nc"
    cut.write_bytes(content[: int(share * len(content))])
    with pytest.raises(SchemaError, match="not a readable netCDF file"):
        open_dataset(cut, MICRO_RESPONSE)


def test_a_full_disk_leaves_the_old_file_and_no_debris(tmp_path, monkeypatch):
    file = tmp_path / "f.txt"
    write_bytes(file, b"old")

    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(MultiscaleError, match=r"cannot write .*f.txt: no space left on device; .*"):
        write_bytes(file, b"new")
    assert file.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [file]


def test_a_step_at_the_largest_load_so_far_holds_and_below_it_unloads():
    branches = branch_of(np.array([1.0, 1.0, 0.5, 0.5, 1.0, 2.0]))
    expected = [LOADING, HOLDING, UNLOADING, UNLOADING, HOLDING, LOADING]
    np.testing.assert_array_equal(branches, expected)

"""NetCDF-4 files of datasets by HDF5 alone, ten times as fast as by the engines of xarray.

Those look up every dimension and attribute by its path again and again, which takes longer than a
small cell. The conventions of values and coordinates are those of xarray all the same.

References
----------
.. [1] NetCDF-4 File Format, NetCDF Users Guide, Appendix C: dimensions are dimension scales.
"""

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import h5py
    import xarray as xr

__all__ = ["decode_dataset", "encode_dataset"]

NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable."
OF_FORMAT = ("CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "DIMENSION_LABELS")
"""Attributes of dimension scales, beside those that begin as :data:`OWN`."""
OWN = ("_Netcdf4", "_nc3_", "_NCProperties")


def encode_dataset(dataset: "xr.Dataset") -> bytes:
    """Return the content of a file."""
    import h5py
    from xarray.conventions import encode_cf_variable, encode_dataset_coordinates

    content = BytesIO()
    variables, attributes = encode_dataset_coordinates(dataset)
    with h5py.File(content, "w", track_order=True) as file:
        for name, size in dataset.sizes.items():
            if name not in variables:
                scale = file.create_dataset(name, (size,), ">f4")
                scale.make_scale(f"{NO_VARIABLE} {size:10d}")
        for name, variable in variables.items():
            values = np.asarray(variable.values)
            if values.dtype.kind in "UO":
                kept = {"data": values.astype(object), "dtype": h5py.string_dtype()}
            else:
                variable = encode_cf_variable(variable, name=name)
                kept = {"data": variable.values}
            stored = file.create_dataset(name, track_order=True, **kept)
            if name in dataset.sizes:
                stored.make_scale(name)
            _write_attributes(stored, variable.attrs)
        for name, variable in variables.items():
            if name not in dataset.sizes:
                for axis, dimension in enumerate(variable.dims):
                    file[name].dims[axis].attach_scale(file[dimension])
        _write_attributes(file, attributes)
    return content.getvalue()


def decode_dataset(path: Path) -> "xr.Dataset":
    """Read a file into memory; a damaged one raises exceptions of many kinds."""
    import h5py
    import xarray as xr

    found = {}
    with h5py.File(path, "r") as file:
        for name in file:
            stored = file[name]
            scale, dims = "CLASS" in stored.attrs, [name]
            if scale and _text(stored.attrs["NAME"]).startswith(NO_VARIABLE):
                continue
            if not scale:
                axes = stored.attrs.get("DIMENSION_LIST", ())
                dims = [h5py.h5r.get_name(one[0], file.id).decode()[1:] for one in axes]
            values = stored[()]
            if h5py.check_string_dtype(stored.dtype):
                values = np.asarray(stored.asstr()[()]).astype(str)
            found[name] = (dims, values, _read_attributes(stored.attrs))
        whole = xr.Dataset(found, attrs=_read_attributes(file.attrs))
    dataset = xr.decode_cf(whole).load()
    dataset.encoding["source"] = str(path)
    return dataset


def _write_attributes(target: "h5py.Dataset | h5py.File", attributes: dict[Any, Any]) -> None:
    for name, value in attributes.items():
        target.attrs[name] = value if isinstance(value, str) else np.atleast_1d(value)


def _read_attributes(attributes: "h5py.AttributeManager") -> dict[str, Any]:
    """Leave out what belongs to the format; an array of one number is a number."""
    own = (name for name in attributes if name not in OF_FORMAT and not name.startswith(OWN))
    return {name: _text(attributes[name]) for name in own}


def _text(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode()
    return value[0] if np.shape(value) == (1,) else value

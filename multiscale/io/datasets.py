"""Datasets in netCDF files: checked against their schema, written atomically, with provenance."""

import logging
import os
import platform
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from multiscale import __version__
from multiscale.errors import NewerSchemaError, SchemaError
from multiscale.io.files import write_bytes
from multiscale.schema import INTERFACE_LAW, MICRO_RESPONSE, SCHEMAS, Schema

if TYPE_CHECKING:
    import xarray as xr

logger = logging.getLogger(__name__)

LIBRARIES = ("numpy", "scipy", "numba", "scikit-fem", "xarray")
"""Libraries with influence of their version on results."""


def write_dataset(
    dataset: "xr.Dataset", path: Path, schema: Schema, **attributes: str | float | int
) -> None:
    """Check a dataset against its schema and write it with its provenance.

    Parameters
    ----------
    **attributes
        Further attributes, such as the checksum of the case.

    Raises
    ------
    SchemaError
        If the dataset does not follow the schema.
    MultiscaleError
        If the file cannot be written.
    """
    import h5netcdf
    import xarray as xr

    schema.check(dataset)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    complete = dataset.assign_attrs(
        Conventions="CF-1.11",
        schema=schema.name,
        schema_version=schema.version,
        source=f"multiscale {__version__}",
        history=f"{now}: {' '.join([Path(sys.argv[0]).name, *sys.argv[1:]])}",
        environment=_environment(),
        **attributes,
    )
    content = BytesIO()
    # to_netcdf would import dask where it is installed, and ask a cluster for a lock on these bytes
    with h5netcdf.File(content, "w") as file:
        complete.dump_to_store(xr.backends.H5NetCDFStore(file, lock=False))
    write_bytes(path, content.getvalue())


@cache
def _environment() -> str:
    libraries = ", ".join(f"{name} {version(name)}" for name in LIBRARIES)
    machine = f"{platform.system()} on {platform.machine()}, {os.cpu_count()} cores"
    return f"Python {platform.python_version()}, {libraries}; {machine}"


def open_dataset(path: str | PathLike[str], schema: Schema | None = None) -> "xr.Dataset":
    """Read a dataset into memory and check it.

    Parameters
    ----------
    schema : Schema, optional
        Schema that the dataset must follow; the schema that it names if not given.

    Raises
    ------
    SchemaError
        If the file is missing, damaged, of another kind or of another schema version.
    """
    path = Path(path)
    kind = f"a {schema.name!r} dataset" if schema else "a dataset"
    if not path.is_file():
        state = "not a file" if path.exists() else "no such file"
        raise SchemaError(f"{path}: {state}; it should contain {kind}")
    dataset = _load(path)
    if dataset is None:
        raise SchemaError(
            f"{path}: not a readable netCDF file (it may be truncated); make it again"
        )
    name, version = dataset.attrs.get("schema"), dataset.attrs.get("schema_version")
    expected = schema or SCHEMAS.get(str(name))
    if expected is None or name != expected.name:
        raise SchemaError(f"{path}: schema {name!r}, expected {kind}; pass the matching file")
    if version != expected.version:
        both = f"{name} of schema version {version}, this package reads version {expected.version}"
        if str(version).isdigit() and int(str(version)) > expected.version:
            raise NewerSchemaError(f"{path}: {both}; use a newer multiscale")
        news = f", which has {expected.news}" if expected.news else ""
        raise SchemaError(f"{path}: {both}{news}; make it again or use the matching package")
    try:
        expected.check(dataset)
    except SchemaError as error:
        raise SchemaError(f"{path}: {error}") from error
    return dataset


def _load(path: Path) -> "xr.Dataset | None":
    """Load a file; None if it is damaged, for which h5py and xarray raise many exceptions."""
    import h5netcdf
    import xarray as xr

    hook, dataset = sys.unraisablehook, None
    # h5netcdf fails again when it deletes a file it cannot open
    sys.unraisablehook = lambda _: None
    try:
        with h5netcdf.File(path, "r", decode_vlen_strings=True) as file:
            dataset = xr.load_dataset(xr.backends.H5NetCDFStore(file))
        dataset.encoding["source"] = str(path)
    except Exception as error:
        logger.debug("%s: %s", path, error)
    finally:
        sys.unraisablehook = hook
    return dataset


def open_response(path: str | PathLike[str]) -> "xr.Dataset":
    """Read a micro response; see :func:`open_dataset`."""
    return open_dataset(path, MICRO_RESPONSE)


def open_law(path: str | PathLike[str]) -> "xr.Dataset":
    """Read an interface law; see :func:`open_dataset`."""
    return open_dataset(path, INTERFACE_LAW)


def save_law(law: "xr.Dataset", path: str | PathLike[str]) -> None:
    """Write an interface law; see :func:`write_dataset`."""
    write_dataset(law, Path(path), INTERFACE_LAW)


def open_run(folder: str | PathLike[str]) -> "xr.DataTree":
    """Read the datasets of a run: a node for each dataset, named as its stage.

    Parameters
    ----------
    folder : path, run folder, or the folder of a sweep

    Returns
    -------
    DataTree
        The available datasets, such as ``micro_response``, ``shear_response``,
        ``interface_law`` and ``macro_result`` of a case with cells that are sheared.

    Raises
    ------
    SchemaError
        If the folder has no results, or a file is refused.
    """
    import xarray as xr

    folder = Path(folder)
    datasets = {
        f"/{name}": open_dataset(folder / f"{name}.nc", schema)
        for name, schema in SCHEMAS.items()
        if (folder / f"{name}.nc").exists()
    }
    if not datasets:
        raise SchemaError(
            f"{folder}: no results; the folder of a run has the dataset of each stage, such as "
            f"{INTERFACE_LAW.name}.nc"
        )
    return xr.DataTree.from_dict(datasets, name=folder.name)


@contextmanager
def reading_run(folder: str | PathLike[str]) -> Iterator[None]:
    """Report a missing variable or attribute of a dataset of a run in a sentence."""
    try:
        yield
    except KeyError as error:
        lost = re.search(r"'([^']*)'", str(error))
        raise SchemaError(
            f"{folder}: a dataset of the run has no {lost[1] if lost else error}, as in runs of an "
            f"earlier version; run the case again into the same folder"
        ) from error

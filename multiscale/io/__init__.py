"""Readers and writers: the only place where files are opened."""

from multiscale.io.csv_tables import finite, positive, read_table
from multiscale.io.datasets import (
    open_dataset,
    open_law,
    open_response,
    open_run,
    reading_run,
    save_law,
    write_dataset,
)
from multiscale.io.fields import (
    write_body_fields,
    write_grain_fields,
    write_life_fields,
    write_link_fields,
    write_mode_fields,
    write_surface_fields,
)
from multiscale.io.files import (
    logging_to,
    make_folder,
    read_bytes,
    read_text,
    remove,
    try_to_write,
    write_bytes,
)
from multiscale.io.images import VoxelImage, read_images
from multiscale.io.meshes import open_mesh, read_mesh
from multiscale.io.named_mesh import NamedMesh, named_mesh
from multiscale.io.surface_file import Topography, open_topography, read_surface

__all__ = [
    "NamedMesh",
    "Topography",
    "VoxelImage",
    "finite",
    "logging_to",
    "make_folder",
    "named_mesh",
    "open_dataset",
    "open_law",
    "open_mesh",
    "open_response",
    "open_run",
    "open_topography",
    "positive",
    "read_bytes",
    "read_images",
    "read_mesh",
    "read_surface",
    "read_table",
    "read_text",
    "reading_run",
    "remove",
    "save_law",
    "try_to_write",
    "write_body_fields",
    "write_bytes",
    "write_dataset",
    "write_grain_fields",
    "write_life_fields",
    "write_link_fields",
    "write_mode_fields",
    "write_surface_fields",
]

__dir__ = __all__.copy

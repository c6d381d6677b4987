"""HDF5 files that look up each object once."""

from typing import Any

import h5py

__all__ = ["KeptObjects"]


class KeptObjects(h5py.File):  # type: ignore[misc]
    """A file that keeps its objects.

    h5netcdf asks for a variable by its path each time that it needs a property of it, which takes
    more than half of the time to read or write a small dataset.
    """

    def __init__(self, file: Any, mode: str) -> None:
        super().__init__(file, mode, track_order=True if mode == "w" else None)  # as netCDF asks
        self._objects: dict[str, Any] = {}

    def __getitem__(self, name: Any) -> Any:
        """Return an object by its path, or by a reference."""
        if not isinstance(name, str):
            return super().__getitem__(name)
        if name not in self._objects or self._objects[name].name is None:  # none yet, or deleted
            self._objects[name] = super().__getitem__(name)
        return self._objects[name]

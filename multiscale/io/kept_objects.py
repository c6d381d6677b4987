"""HDF5 files that look up each object once."""

from typing import Any

import h5py

__all__ = ["KeptObjects"]


class KeptObjects(h5py.File):  # type: ignore[misc]
    """A file to read, which keeps its objects.

    h5netcdf asks for a variable by its path each time that it needs a property of it, which takes
    more than half of the time to read a small dataset.
    """

    def __init__(self, path: Any) -> None:
        super().__init__(path, "r")
        self._objects: dict[str, Any] = {}

    def __getitem__(self, name: Any) -> Any:
        """Return an object by its path, or by a reference."""
        if not isinstance(name, str):
            return super().__getitem__(name)
        if name not in self._objects:
            self._objects[name] = super().__getitem__(name)
        return self._objects[name]

"""Damage of netCDF files that causes an endless loop in the HDF5 library."""

from mmap import ACCESS_READ, mmap
from pathlib import Path
from struct import Struct

__all__ = ["is_endless"]

COLLECTION, OBJECT = Struct("<4sB3xQ"), Struct("<HH4xQ")
"""Headers of a collection (signature, version, size) and of an object in it (index, references,
size), both little-endian."""


def is_endless(file: Path) -> bool:
    """Whether a collection of the global heap has an object that does not lead to the next one.

    Such collections contain the texts of attributes. The library (2.0.0) reads an object without
    size without end.

    References
    ----------
    .. [1] HDF5 File Format Specification Version 3.0, III.E, Disk Format: Level 1E - Global Heap.
    """
    if not file.stat().st_size:
        return False
    with file.open("rb") as opened, mmap(opened.fileno(), 0, access=ACCESS_READ) as data:
        start = data.find(b"GCOL")
        while start >= 0:
            if _is_endless(data, start):
                return True
            start = data.find(b"GCOL", start + 1)
    return False


def _is_endless(data: mmap, start: int) -> bool:
    """Whether the library would not reach the end of the collection at a byte."""
    if start + COLLECTION.size > len(data):
        return False
    _, version, size = COLLECTION.unpack_from(data, start)
    end = start + size
    if version != 1 or end > len(data):
        return False  # refused by the library
    at = start + COLLECTION.size
    while at + OBJECT.size <= end:
        index, _, length = OBJECT.unpack_from(data, at)
        # the last object, of index 0, is the free space; its size includes its header
        step = length if index == 0 else OBJECT.size + 8 * -(-length // 8)
        if not 0 < step <= end - at:
            return True
        at += step
    return False

"""Results of the points of a sweep in one file, each whole or absent whatever is killed."""

import json
import sqlite3
import zlib
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from multiscale.errors import FileError
from multiscale.schema import SWEEP

__all__ = ["STORE", "Point", "PointStore", "open_store"]

STORE = "points.sqlite"
"""Name of the file in the folder of a sweep."""

SETTINGS = ("locking_mode = EXCLUSIVE", "journal_mode = WAL", "synchronous = NORMAL")
"""No commit waits for the disk, and one process writes, also on disks of a network."""


@dataclass(frozen=True)
class Point:
    """Result of a point, as small as the dataset of the sweep needs it.

    Attributes
    ----------
    answers : tuple of str, names
    values : dict
        Each answer and each of its intervals by name: ``dims``, ``attrs`` and ``data`` as of
        ``Dataset.to_dict``.
    caution, failure : str, what to beware of, a line for each, and why there is no result
    missing : str, terms of the error that the intervals lack
    final : bool, whether the same case would give the same again
    """

    answers: tuple[str, ...] = ()
    values: dict[str, Any] = field(default_factory=dict)
    caution: str = ""
    failure: str = ""
    missing: str = ""
    final: bool = True


@dataclass(frozen=True)
class PointStore:
    """Results of points by the names of their folders; see :func:`open_store`."""

    file: Path
    connection: sqlite3.Connection

    def keep(self, name: str, point: Point) -> None:
        """Write the result of a point, which a kill leaves as a whole or not at all."""
        content = zlib.compress(json.dumps(asdict(point)).encode())
        with _said(self.file):
            row = (name, point.final, content)
            self.connection.execute("INSERT OR REPLACE INTO point VALUES (?, ?, ?)", row)

    def finished(self) -> set[str]:
        """Return the names of all points whose result is final."""
        with _said(self.file):
            return {
                name for (name,) in self.connection.execute("SELECT name FROM point WHERE final")
            }

    def read(self, name: str) -> Point:
        """Return the result of a point."""
        with _said(self.file):
            query = "SELECT content FROM point WHERE name = ?"
            ((content,),) = self.connection.execute(query, (name,))
        return Point(**json.loads(zlib.decompress(content)))


@contextmanager
def open_store(folder: Path) -> Iterator[PointStore]:
    """Open the file of results in the folder of a sweep, or begin it.

    Results of an earlier version of ``SWEEP`` are dropped.
    """
    file = folder / STORE
    with _said(file):
        connection = sqlite3.connect(file, isolation_level=None)  # each statement is committed
    with closing(connection):
        with _said(file):
            for setting in SETTINGS:
                connection.execute(f"PRAGMA {setting}")
            if connection.execute("PRAGMA user_version").fetchone() != (SWEEP.version,):
                connection.execute("DROP TABLE IF EXISTS point")
            connection.execute(
                "CREATE TABLE IF NOT EXISTS point (name TEXT PRIMARY KEY, final INT, content BLOB)"
            )
            connection.execute(f"PRAGMA user_version = {SWEEP.version}")
        yield PointStore(file, connection)


@contextmanager
def _said(file: Path) -> Iterator[None]:
    """Report an error of the file in a sentence."""
    try:
        yield
    except sqlite3.Error as error:
        raise FileError(
            f"{file}: {error}; finished points stay, so free some space, end other runs into the "
            f"folder or choose another one, and run again"
        ) from error

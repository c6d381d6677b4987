"""Files that are either complete or absent, and errors of the operating system as sentences."""

import errno
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkstemp

from multiscale.errors import CaseError, FileError, suggest


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write a file under a temporary name, force it to the disk, then rename it.

    Raises
    ------
    FileError
        If the disk is full or the folder cannot be written to.
    """
    with replacing(path) as temporary:
        temporary.write_bytes(content)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a temporary name in the folder of a file, and rename it if no error occurs."""
    with writing(path):
        temporary = _temporary_file(path)
        try:
            yield temporary
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            mask = os.umask(0)  # a temporary file is private; set the mode of ordinary files
            os.umask(mask)
            temporary.chmod(0o666 & ~mask)
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


def _temporary_file(path: Path) -> Path:
    descriptor, name = mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    os.close(descriptor)
    return Path(name)


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Report an error of the operating system on writing as a ``FileError``."""
    try:
        yield
    except OSError as error:
        remedy = "choose another folder"
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            remedy = "finished results stay, so free some space and run again"
        raise FileError(f"cannot write {path}: {system_reason(error)}; {remedy}") from error


def system_reason(error: OSError) -> str:
    """Return the reason of an error of the operating system."""
    return (error.strerror or str(error)).lower()


def try_to_write(path: Path) -> None:
    """Create the folder of a file, and refuse a file that cannot be written, before a long run."""
    make_folder(path.parent)
    with writing(path):
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        _temporary_file(path).unlink()


def remove(path: Path) -> None:
    """Remove a file, if it is there."""
    with writing(path):
        path.unlink(missing_ok=True)


def make_folder(path: Path) -> Path:
    """Create a folder and its parents, and return it."""
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
    return path


@contextmanager
def logging_to(path: Path) -> Iterator[None]:
    """Append the log of the package to a file within the context; a full disk ends the log."""
    with writing(path):
        handler = _RunLog(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(name)s: %(message)s"))
    logger = logging.getLogger("multiscale")
    level = logger.level
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.setLevel(level)
        logger.removeHandler(handler)
        with suppress(OSError):  # the disk is full
            handler.close()


class _RunLog(logging.FileHandler):
    """A log that raises no errors: other writers report a full disk."""

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802
        """Ignore a line that cannot be written."""


def read_bytes(path: Path) -> bytes:
    """Read a whole file."""
    check_file(path)
    try:
        return path.read_bytes()
    except OSError as error:
        raise CaseError(f"{path}: {system_reason(error)}") from error


def check_file(path: Path, kind: str = "file") -> None:
    """Refuse a path that is missing, a folder, a device or a pipe; ``kind`` is the file needed."""
    if path.is_dir():
        raise CaseError(f"{path}: is a directory; give a {kind} in it")
    if not path.exists():
        raise CaseError(missing_file(path))
    if not path.is_file():
        raise CaseError(f"{path}: is a device or a pipe; give a {kind}")


def missing_file(path: Path) -> str:
    """Format the message about a missing file, with a similar name in its folder if any."""
    names: list[str] = []
    with suppress(OSError):
        names = [entry.name for entry in path.parent.iterdir()]
    return f"{path}: no such file; {suggest(path.name, names, 'check the name and the folder')}"


def first_line(error: Exception) -> str:
    """Return the first line of an error of a library, or its class if it has no message."""
    lines = str(error).strip().splitlines() or [type(error).__name__]
    return lines[0][:200].rstrip(".")


def read_text(path: Path) -> str:
    """Read a text file, without its byte order mark.

    Raises
    ------
    CaseError
        If the file is missing, cannot be read or is not text.
    """
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise CaseError(f"{path}: not a text file (byte {error.start} is not UTF-8)") from error

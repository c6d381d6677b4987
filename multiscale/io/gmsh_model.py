"""Models of the mesh generator gmsh: empty models, geometry scripts, and meshes in its formats."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from multiscale.errors import CaseError


@contextmanager
def gmsh_model(name: str) -> Iterator[Any]:
    """Open an empty model of gmsh, without a change of the signal handlers of the process."""
    try:
        import gmsh
    except (ImportError, OSError) as error:
        raise CaseError(
            f"the mesh generator gmsh cannot be loaded ({error}); install gmsh (by the system "
            f"where it has no wheel) and libglu1-mesa, libxrender1, libxcursor1, libxft2 and "
            f"libxinerama1"
        ) from error
    started = not gmsh.isInitialized()
    if started:
        main = threading.current_thread() is threading.main_thread()
        pipes = main and hasattr(signal, "SIGPIPE")  # not on Windows
        before = signal.getsignal(signal.SIGPIPE) if pipes else None
        gmsh.initialize(interruptible=False)
        if before is not None:
            signal.signal(signal.SIGPIPE, before)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.model.add(name)
    try:
        yield gmsh
    finally:
        gmsh.model.remove()
        if started:
            gmsh.finalize()


@contextmanager
def _refusals(gmsh: Any, subject: str) -> Iterator[None]:
    gmsh.logger.start()
    try:
        yield
    except Exception as error:  # gmsh raises bare Exceptions
        wrong = [line for line in gmsh.logger.get() if line.startswith("Error")]
        reason = (wrong or str(error).splitlines() or ["no reason given"])[0]
        raise CaseError(f"gmsh cannot process the {subject} ({reason})") from error
    finally:
        gmsh.logger.stop()


@contextmanager
def _silent() -> Iterator[None]:
    """Drop prints of the libraries of gmsh: the reader of MED writes to the terminal on errors."""
    stderr = os.dup(2)
    try:
        with Path(os.devnull).open("w") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)


@lru_cache(maxsize=8)
def mesh_geometry(script: str, element_size: float) -> bytes:
    """Mesh a geometry in gmsh's script language; return a file in format 2.2 of gmsh."""
    with TemporaryDirectory() as folder, gmsh_model("geometry") as gmsh:
        source, made = Path(folder) / "geometry.geo", Path(folder) / "geometry.msh"
        source.write_text(script, encoding="utf-8")
        try:
            with _refusals(gmsh, "geometry"):
                gmsh.option.setNumber("Mesh.MeshSizeMax", element_size)  # the script may read it
                gmsh.merge(str(source))
                gmsh.option.setNumber("Mesh.MeshSizeMax", element_size)
                gmsh.option.setNumber("Mesh.MshFileVersion", 2.2)
                gmsh.model.mesh.generate(3)
                gmsh.write(str(made))
        except CaseError as error:
            raise CaseError(str(error).replace(str(source), "line")) from error
        return made.read_bytes()


def write_whole_mesh(path: Path, made: Path) -> None:
    """Read a mesh by gmsh, and write all its elements in format 4.1 of gmsh."""
    with gmsh_model("mesh") as gmsh, _refusals(gmsh, "mesh"):
        with _silent():
            gmsh.merge(str(path))
        for dimension in range(4):
            entities = [tag for _, tag in gmsh.model.getEntities(dimension)]
            grouped = gmsh.model.getPhysicalGroupsForEntity
            nameless = [tag for tag in entities if not len(grouped(dimension, tag))]
            if nameless:
                gmsh.model.addPhysicalGroup(dimension, nameless)
        gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
        gmsh.option.setNumber("Mesh.SaveAll", 0)
        gmsh.write(str(made))

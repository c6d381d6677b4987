"""An empty model of the mesh generator gmsh."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from multiscale.errors import CaseError

__all__ = ["gmsh_model"]


@contextmanager
def gmsh_model(name: str) -> Iterator[Any]:
    """Open an empty model of gmsh, and keep the signal handlers of the process.

    Raises
    ------
    CaseError
        If gmsh cannot be loaded.
    """
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

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
            f"the mesh generator gmsh cannot be loaded ({error}); install gmsh and the system's "
            f"libglu1-mesa, libxrender1, libxcursor1, libxft2 and libxinerama1"
        ) from error
    started = not gmsh.isInitialized()
    if started:
        main = threading.current_thread() is threading.main_thread()
        before = signal.getsignal(signal.SIGPIPE) if main else None
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

"""What a result says of the structure itself."""

from typing import Any

import numpy as np

from multiscale.macro.discrete.link_system import LinkSystem

__all__ = ["describe"]


def describe(system: LinkSystem) -> dict[str, Any]:
    """Return the variables of ``MACRO_RESULT`` that a figure of the structure needs."""
    names = np.array([type(law).__name__.lower() for law in system.laws])
    return {"position": system.position, "ends": system.ends, "law": names[system.kind]}

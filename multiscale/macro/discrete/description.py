"""Variables of a result that describe the structure."""

from typing import Any

import numpy as np

from multiscale.macro.discrete.link_system import LinkSystem

__all__ = ["describe"]


def describe(system: LinkSystem) -> dict[str, Any]:
    """Return position, ends and law of ``MACRO_RESULT``, from which the structure is drawn."""
    names = np.array([type(law).__name__.lower() for law in system.laws])
    return {"position": system.position, "ends": system.ends, "law": names[system.kind]}

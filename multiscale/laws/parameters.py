"""Ranges of the parameters of laws."""

import numpy as np

from multiscale.errors import CaseError

__all__ = ["check_parameter"]


def check_parameter(
    law: object, name: str, unit: str = "1", *, lowest: float | None = None
) -> None:
    """Refuse a parameter of a law that is outside its range."""
    value = np.asarray(getattr(law, name), dtype=float)
    allowed = np.isfinite(value) & (value > 0.0 if lowest is None else value >= lowest)
    if allowed.all():
        return
    bound = {None: "be positive and", 0.0: "not be negative, but"}
    asked = bound.get(lowest, f"be at least {lowest:g} and" if lowest else "")
    raise CaseError(f"{name} must {asked} finite ({unit}), got {float(value[~allowed].flat[0]):g}")

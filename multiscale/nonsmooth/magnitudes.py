"""Refusal of data whose answers are no floating-point numbers."""

import numpy as np

from multiscale.errors import CaseError

__all__ = ["refuse_out_of_range"]

LARGEST_EXPONENT = 300
"""Power of ten of the unknowns beyond which parts of 1e-8 of them have no digits or overflow."""


def refuse_out_of_range(vector: np.ndarray, stiffness: np.ndarray) -> None:
    r"""Raise if :math:`-q_i / M_{ii}` under- or overflows in the row where it is largest."""
    rows = (vector < 0.0) & (stiffness > 0.0)
    if not rows.any():
        return
    exponent = float(np.max(np.log10(-vector[rows]) - np.log10(stiffness[rows])))
    if abs(exponent) > LARGEST_EXPONENT:
        raise CaseError(
            f"the unknowns are about 10^{exponent:.0f} in the units of the data, which is outside "
            f"of the floating-point numbers; choose other units"
        )

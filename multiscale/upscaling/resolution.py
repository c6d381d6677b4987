"""Error of a discretisation from the same answer on coarser grids."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError

__all__ = ["GridEstimate", "estimate_grid_error"]

ORDERS = (0.5, 3.0)  # outside, differences do not tell an order
LOWEST_ORDER = 1.0
ALIKE = 0.5  # cosine of the differences over the steps
SAFETY = 1.25
UNSURE = 3.0


@dataclass(frozen=True, eq=False)
class GridEstimate:
    """What coarser grids tell of an answer."""

    error: np.ndarray  # answer minus limit, in the unit of the answer
    half_width: np.ndarray  # about a 95 % bound on its size, same unit
    order: float  # observed, of all answers and steps; NaN if the grids tell none
    how: str  # the estimate in words


def estimate_grid_error(answer: np.ndarray, coarser: Mapping[float, np.ndarray]) -> GridEstimate:
    r"""Estimate the error of an answer by Richardson's extrapolation.

    Parameters
    ----------
    answer : ndarray, shape (..., steps), on the finest grid; any unit, for each answer its own
    coarser : mapping of float to ndarray, shape (..., steps)
        From the ratio :math:`r > 1` of the spacings to the answer there; one or two grids, the
        second with :math:`r^2`.

    Raises
    ------
    CaseError
        If there is no coarser grid or a ratio is not above 1.

    Notes
    -----
    With :math:`d_1 = f_1 - f_2` from the finest two grids and :math:`d_2 = f_2 - f_3`, and norms
    over the steps of differences relative to :math:`f_1`,

    .. math::
        q = \frac{\ln (\|d_2\| / \|d_1\|)}{\ln r}, \qquad e = -\frac{d_1}{r^q - 1}, \qquad
        |e_{95}| = 1.25\, |e|.    \tag{1}

    The order belongs to the discretisation and is one for all answers and steps: at a single step,
    where a difference passes through zero, the ratio of both may be anything, and the bound is at
    least the root mean square of :math:`e_{95}` over the steps there. With one coarser grid the
    order is 1, the order of the contact fraction and the lowest of the averages, and this bound
    holds at all steps of an answer whose :math:`d_1` changes its sign over them. Where three grids
    tell no order between 0.5 and 3, or the differences are not alike (a cosine below a half), the
    bound is three times the largest difference. The factors are taken from the grid convergence
    index [1]_. Where a coarser grid has no answer, NaN, the error is not known.

    References
    ----------
    .. [1] P. J. Roache, J. Fluids Eng. 116 (1994) 405-413, doi:10.1115/1.2910291.
    """
    if not coarser:
        raise CaseError("the error of a grid is estimated from at least one coarser one")
    ratios = sorted(coarser)
    r = ratios[0]
    if not r > 1.0:
        raise CaseError(f"the spacing of a coarser grid is more than once the finest, got {r:g}")
    fine = np.asarray(answer, dtype=float)
    d1 = fine - coarser[r]
    scale = np.where(fine != 0.0, np.abs(fine), 1.0)
    if len(ratios) == 1 or abs(ratios[1] - r**2) > 0.05 * r**2:
        error = -d1 / (r**LOWEST_ORDER - 1.0)
        falls, rises = (np.any(one, axis=-1, keepdims=True) for one in (d1 < 0.0, d1 > 0.0))
        how = f"one coarser grid (spacing {r:g} times), order taken as {LOWEST_ORDER:g}"
        return GridEstimate(error, SAFETY * _size(error, scale, ~(falls & rises)), np.nan, how)
    d2 = coarser[r] - coarser[ratios[1]]
    product, *squares = (float(np.nansum(one / scale**2)) for one in (d1 * d2, d1**2, d2**2))
    how = f"two coarser grids (spacing {r:g} and {ratios[1]:g} times), observed order "
    order = 0.5 * np.log(squares[1] / squares[0]) / np.log(r) if min(squares) > 0.0 else np.nan
    alike = product > ALIKE * np.sqrt(squares[0] * squares[1])
    if not (alike and ORDERS[0] <= order <= ORDERS[1]):
        unsure = UNSURE * np.maximum(np.abs(d1), np.abs(d2)) / (r - 1.0)
        return GridEstimate(-d1 / (r**LOWEST_ORDER - 1.0), unsure, np.nan, how + "none")
    error = -d1 / (r**order - 1.0)
    size = _size(error, scale, d1 * d2 > 0.0)
    return GridEstimate(error, SAFETY * size, float(order), how + f"{order:.2g}")


def _size(error: np.ndarray, scale: np.ndarray, sure: np.ndarray) -> np.ndarray:
    """Size of errors, at least the root mean square of relative ones over the steps if not sure."""
    square = (error / scale) ** 2
    known = np.isfinite(square)
    count = np.maximum(np.count_nonzero(known, axis=-1, keepdims=True), 1)
    usual = scale * np.sqrt(np.sum(square, axis=-1, keepdims=True, where=known) / count)
    return np.asarray(np.where(sure, np.abs(error), np.maximum(np.abs(error), usual)))

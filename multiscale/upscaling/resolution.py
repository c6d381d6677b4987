"""Error of a discretisation from the same answer on coarser grids."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError

__all__ = ["GridEstimate", "estimate_grid_error"]

ORDERS = (0.5, 3.0)  # outside, differences do not tell an order
LOWEST_ORDER = 1.0
SAFETY = 1.25
UNSURE = 3.0


@dataclass(frozen=True, eq=False)
class GridEstimate:
    """What coarser grids tell of an answer.

    Attributes
    ----------
    error : ndarray, shape (steps,)
        Estimated error of the answer, answer minus limit, in its unit.
    half_width : ndarray, shape (steps,)
        About a 95 % bound on its size, same unit.
    order : ndarray, shape (steps,)
        Observed order; NaN where the grids tell none.
    how : str
        The estimate in words.
    """

    error: np.ndarray
    half_width: np.ndarray
    order: np.ndarray
    how: str


def estimate_grid_error(answer: np.ndarray, coarser: Mapping[float, np.ndarray]) -> GridEstimate:
    r"""Estimate the error of an answer by Richardson's extrapolation.

    Parameters
    ----------
    answer : ndarray, shape (steps,)
        On the finest grid; any unit.
    coarser : mapping of float to ndarray, shape (steps,)
        From the ratio :math:`r > 1` of the spacings to the answer there; one or two grids, the
        second with :math:`r^2`.

    Raises
    ------
    CaseError
        If there is no coarser grid or a ratio is not above 1.

    Notes
    -----
    With :math:`d_1 = f_1 - f_2` from the finest two grids and :math:`d_2 = f_2 - f_3`,

    .. math::
        q = \frac{\ln (d_2 / d_1)}{\ln r}, \qquad e = -\frac{d_1}{r^q - 1}, \qquad
        |e_{95}| = 1.25\, |e|.    \tag{1}

    With one coarser grid the order is 1, that of the contact fraction and the lowest of the
    averages. Where three grids tell no order between 0.5 and 3, because the differences change
    sign or grow, the bound is three times the largest difference. The factors are those of the
    grid convergence index [1]_.

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
    if len(ratios) == 1 or abs(ratios[1] - r**2) > 0.05 * r**2:
        error = -d1 / (r**LOWEST_ORDER - 1.0)
        order = np.full(fine.shape, np.nan)
        how = f"one coarser grid (spacing {r:g} times), order taken as {LOWEST_ORDER:g}"
        return GridEstimate(error, SAFETY * np.abs(error), order, how)
    d2 = coarser[r] - coarser[ratios[1]]
    with np.errstate(divide="ignore", invalid="ignore"):
        order = np.log(d2 / d1) / np.log(r)
    sure = (order >= ORDERS[0]) & (order <= ORDERS[1])
    q = np.where(sure, order, LOWEST_ORDER)
    error = -d1 / (r**q - 1.0)
    unsure = UNSURE * np.maximum(np.abs(d1), np.abs(d2)) / (r - 1.0)
    how = f"two coarser grids (spacing {r:g} and {ratios[1]:g} times), observed order "
    how += f"{np.median(order[sure]):.2g}" if np.any(sure) else "none"
    if not np.all(sure):
        how += f", none at {np.count_nonzero(~sure)} of {sure.size} steps"
    half = np.where(sure, SAFETY * np.abs(error), unsure)
    return GridEstimate(error, half, np.where(sure, order, np.nan), how)

"""Whether mean gaps fit the heights and contact fractions of their surfaces."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import Dataset
from multiscale.units import readable

if TYPE_CHECKING:
    from multiscale.upscaling.observations import Observations

__all__ = ["check_heights", "odd_gaps"]

HIGHEST_GAP = 20.0
"""Mean gap over the rms height above which units are wrong, or a single spike is all contact."""

LIGHT, DEEPEST = 0.05, 5.0
"""Contact fraction up to which pressing leaves the heights as they are, and valleys, over the rms
height, that no surface but a scratched one has."""


def check_heights(response: Dataset, gap: np.ndarray, counted: np.ndarray) -> None:
    """Refuse mean gaps above ``HIGHEST_GAP`` rms heights, which no surface keeps open.

    Gaps, m, and which of them exist have the shape (realisations, steps).
    """
    if "rms_height" not in response.variables:
        return
    height = response["rms_height"].to_numpy()[:, None]
    wrong = np.argwhere(counted & (gap > HIGHEST_GAP * height))
    if wrong.size:
        k, j = wrong[0]
        raise CaseError(
            f"realisation {k}, step {j}: the mean gap of {gap[k, j]:.3g} m is "
            f"{gap[k, j] / height[k, 0]:.3g} times the rms height of {height[k, 0]:.3g} m, and "
            f"summits keep surfaces at most about 5 of them apart; convert both to m, or take "
            f"spikes out of the map"
        )


ROUND_OFF = 1e-6
"""Mean gap over the rms height that solvers leave where all of a surface touches."""


def odd_gaps(response: Dataset, found: "Observations") -> Iterator[str]:
    r"""Say which mean gaps do not fit heights and contact fractions, by (1).

    Notes
    -----
    Where heights of zero mean and root mean square h end at g, in a share A of the area, and at -v
    below, the inequalities of Cantelli and of Bhatia and Davis say

    .. math:: g \le h \sqrt{1/A - 1}, \qquad g \ge h^2 / v.    \tag{1}

    Contact flattens a surface, so that h without load serves for the first, and light contact for
    the second. Mean gaps beyond either are a caution: units differ, for instance.
    """
    if "rms_height" not in response.variables:
        return
    kept = response.isel(step=found.order)
    area = kept["contact_fraction"].where(kept["converged"] == 1).mean("realisation").to_numpy()
    share = found.mean / float(response["rms_height"].mean())
    p = [readable(f"{one:.3g} Pa") for one in found.pressure]
    most = np.sqrt(1.0 / np.where(area > 0.0, area, np.nan) - 1.0)
    if np.any(share > most + ROUND_OFF):
        j = int(np.nanargmax(share / np.maximum(most, ROUND_OFF)))
        yield (
            f"the mean gap of {share[j]:.3g} rms heights at {p[j]} is larger than {most[j]:.3g}, "
            f"the most that any surface leaves that touches in {100.0 * area[j]:.3g} % of its "
            f"area: give gaps and rms heights in m"
        )
    light = np.flatnonzero(area <= LIGHT)
    if light.size and share[light].min() < 1.0 / DEEPEST:
        j = int(light[np.argmin(share[light])])
        yield (
            f"the mean gap of {share[j]:.3g} rms heights at {p[j]} needs valleys deeper than "
            f"{1.0 / max(share[j], 1e-9):.3g} of them, since little touches: if the surface has "
            f"none, give gaps and rms heights in m"
        )

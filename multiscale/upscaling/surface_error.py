"""What a law lacks where its cells hold less than the roughness that was measured."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.upscaling.budget_terms import Term
from multiscale.upscaling.reading import area_from_dataset, law_from_dataset

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["surface_term"]

FEWEST_HELD = 0.5
"""Share of height or slope below which a law would be read at less than half its pressures."""


def surface_term(response: "xr.Dataset", law: "xr.Dataset", p: np.ndarray) -> Term:
    r"""Half-widths from the height and the slope of measured maps that the cells lack.

    The gap of an elastic surface over its height, and its contact fraction, are functions of
    :math:`p / (E^* h'_\mathrm{rms})` and of the form of the spectrum. Cells that hold the shares
    :math:`s_h` of the height and :math:`s_g` of the slope thus stand, for one form, for

    .. math::
        \bar g(s_g\, p) / s_h, \qquad A(s_g\, p), \qquad
        s_h\, k(s_g\, p) / s_g \qquad\text{instead of}\qquad
        \bar g(p), \quad A(p), \quad k(p) = -\mathrm{d}p / \mathrm{d}\bar g.

    The changes by :math:`s_h` and by :math:`s_g` are added, not set off against each other. As the
    lost waves change the form too, which similarity does not tell, they count twice.
    """
    if "body_rms_height" not in response:
        nothing = np.zeros((3, p.size))
        return Term("nothing: the surfaces of the cells are not parts of maps", nothing)
    held = []  # of height and slope; squares of independent bodies add
    for name in ("rms_height", "rms_slope"):
        body = response[f"body_{name}"]
        lost = body.sel(stage="map").to_numpy() ** 2 - body.sel(stage="cells").to_numpy() ** 2
        square = float(np.mean(response[name].to_numpy() ** 2))
        # windows that are rougher than their map lack nothing
        held.append(float(np.sqrt(square / (square + np.sum(np.maximum(lost, 0.0))))))
    height, slope = held
    how = f"the cells hold {height:.3g} of the rms height and {slope:.3g} of the rms slope measured"
    if min(held) < FEWEST_HELD:
        unknown = np.full((3, p.size), np.nan)
        return Term(f"not known: {how}, too little to infer the rest from", unknown)
    mean_law, area_law = law_from_dataset(law), area_from_dataset(law)
    gap, area = mean_law.gap_at, area_law.contact_fraction
    similar = mean_law.stiffness(gap(slope * p)) / slope
    rows = [
        1.0 / height - 1.0 + np.abs(gap(slope * p) / gap(p) - 1.0),
        np.abs(area(slope * p) / area(p) - 1.0),
        1.0 - height + np.abs(similar / mean_law.stiffness(gap(p)) - 1.0),
    ]
    return Term(how, 2.0 * np.array(rows))

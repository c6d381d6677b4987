"""Values of every cell for the budget of a law, and errors by wavelengths that cells lack."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import Dataset
from multiscale.upscaling.budget import Term
from multiscale.upscaling.fit import stiffness_of_each
from multiscale.upscaling.reading import area_from_dataset, law_from_dataset
from multiscale.upscaling.response_observations import area_observations, normal_observations

LEAST_SHARE = 0.5
"""Share of height or slope below which a law would be read at less than half its pressures."""


def at_rms_height(response: Dataset, rms_height: float) -> Dataset:
    r"""Return a response with the gaps of surfaces of another height.

    Parameters
    ----------
    response : Dataset, follows ``MICRO_RESPONSE``, with the ``rms_height`` of every realisation
    rms_height : float
        Root mean square height of the surface at large, m: of a patch of many of the longest
        wavelengths, which need not be solved. It becomes the attribute ``gaps_at_rms_height``.

    Raises
    ------
    CaseError
        If the height is not positive, or the response has no heights.

    Notes
    -----
    Small periodic cells have few long wavelengths, and their root mean square height :math:`h_k` is
    not the height :math:`h` of the surface. At equal slope, gaps are in proportion to the heights,
    so that :math:`g_k\, h / h_k` has less bias and less scatter. The rest of the bias falls with
    the size of the cell.
    """
    if not (rms_height > 0.0 and np.isfinite(rms_height)):
        raise CaseError(f"rms_height must be positive and finite (m), got {rms_height:g}")
    if "rms_height" not in response.variables:
        raise CaseError(
            "the response has no rms_height of its realisations; add it (m) along realisation"
        )
    ratio = rms_height / response["rms_height"].to_numpy()
    gap = response["mean_gap"].copy(data=response["mean_gap"].to_numpy() * ratio[:, None])
    return response.assign(mean_gap=gap).assign_attrs(gaps_at_rms_height=rms_height)  # m


def surface_term(response: Dataset, law: Dataset, p: np.ndarray) -> Term:
    r"""Estimate the half-widths from the height and slope of measured maps that the cells lack.

    The gap of an elastic surface over its height, and its contact fraction, are functions of
    :math:`p / (E^* h'_\mathrm{rms})` and of the form of the spectrum. Cells with the shares
    :math:`s_h` of the height and :math:`s_g` of the slope thus stand, at equal form, for

    .. math::
        \bar g(s_g\, p) / s_h, \qquad A(s_g\, p), \qquad
        s_h\, k(s_g\, p) / s_g \qquad\text{instead of}\qquad
        \bar g(p), \quad A(p), \quad k(p) = -\mathrm{d}p / \mathrm{d}\bar g.

    The changes by :math:`s_h` and by :math:`s_g` are added, not set off against each other. As the
    lost wavelengths change the form too, which similarity does not capture, they count twice.
    """
    if "body_rms_height" not in response:
        nothing = np.zeros((3, p.size))
        return Term("nothing: the surfaces of the cells are not windows of maps", nothing)
    shares = []  # of height and slope; squares of independent bodies add
    for name in ("rms_height", "rms_slope"):
        body = response[f"body_{name}"]
        lost = body.sel(stage="map").to_numpy() ** 2 - body.sel(stage="cells").to_numpy() ** 2
        square = float(np.mean(response[name].to_numpy() ** 2))
        # windows that are rougher than their map lack nothing
        shares.append(float(np.sqrt(square / (square + np.sum(np.maximum(lost, 0.0))))))
    height, slope = shares
    how = f"the cells hold {height:.3g} of the rms height and {slope:.3g} of the rms slope"
    if min(shares) < LEAST_SHARE:
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


def values_of_cells(response: Dataset) -> np.ndarray:
    """Return gap, contact fraction and stiffness, (3, realisations, steps); NaN where missing."""
    return np.array([values for ((values, _),) in ensembles_of_cells(response)])


def ensembles_of_cells(
    response: Dataset, control: Dataset | None = None, law: Dataset | None = None
) -> list[list[tuple[np.ndarray, int]]]:
    """Return ensembles, (values, freedom), with means that add up to gap, area and stiffness."""
    gap, area = normal_observations(response, control), area_observations(response, control)
    stiffness = [
        (stiffness_of_each(replace(gap, values=values, control=None), law), freedom)
        for values, freedom in gap.ensembles
    ]
    return [[*gap.ensembles], [*area.ensembles], stiffness]


def compared(response: Dataset, others: Mapping[float, Dataset]) -> dict[float, Dataset]:
    """Return compared responses by their ratios, with the response where none has the ratio 1."""
    if list(others) == [1.0]:
        raise CaseError(
            "resolutions with the spacing of the response are compared among themselves, so that "
            "two are needed, got 1"
        )
    expected = normal_observations(response).pressure
    for ratio, other in others.items():
        p = normal_observations(other).pressure
        if p.size != expected.size or not np.allclose(p, expected, rtol=1e-6):
            raise CaseError(
                f"the response at the ratio {ratio:g} has other pressures; press it as the first"
            )
    return {1.0: response, **others}

"""Errors of a law by the size of its cells, and by wavelengths that they lack."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import Dataset
from multiscale.upscaling.budget import NORMAL, Term
from multiscale.upscaling.fit import stiffness_of_each
from multiscale.upscaling.reading import area_from_dataset, law_from_dataset
from multiscale.upscaling.response_observations import area_observations, normal_observations

SIZE_ORDERS = np.linspace(1.0, 3.0, 11)  # powers of the cell size
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
    the size of the cell, and ensembles of several sizes, all treated alike, still measure it.
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


def size_term(
    response: Dataset,
    sizes: Mapping[float, Dataset],
    *,
    apart: bool = False,
) -> Term:
    r"""Bias by the size of the cell and half-widths about it, from the means of several sizes.

    The difference of the mean from an infinite cell falls as a power of the size: the scatter has
    the power 1, its square, through the curvature of a law, 2, and the lattice of the wave vectors
    of a periodic cell about 1.5; cells with a handful of contacts change faster, so that powers
    from 1 to 3 are taken. For each power
    the bias is a weighted sum :math:`\sum_i w_i m_i` of the means, and powers count by their
    likelihood; with two sizes, which fit any power, alike. How the powers differ adds to the
    half-width. Where the response is among the sizes, its error :math:`\epsilon_0` enters twice,
    as :math:`(1 - w_0)\, \epsilon_0`, and the sampling term contains :math:`\epsilon_0`; ensembles
    ``apart`` from the response have no such share.
    """
    responses = compared(response, sizes, apart=apart)
    ratios = np.array(sorted(responses))
    cells = [values_of_cells(responses[ratio]) for ratio in ratios]
    shared = 0.0 if apart else 1.0 * (ratios == 1.0)
    biases, rows, powers = [], [], []
    for answer, *samples in zip(values_of_cells(response), *cells, strict=True):
        # means of the sizes, and their variances
        mean = np.array([np.nanmean(values, axis=0) for values in samples])
        count = [np.maximum(np.isfinite(values).sum(axis=0) - 1, 1) for values in samples]
        variance = np.array([np.nanvar(values, axis=0) for values in samples]) / count
        variance = np.maximum(variance, (1e-9 * mean) ** 2)
        freedom = np.array([[max(len(values) - 1, 1)] for values in samples])
        # bias, its half-width and the misfit by each power
        bias, noise, misfit = [], [], []
        for order in SIZE_ORDERS:
            weight, miss = _slope(ratios**-order, mean, np.sqrt(variance))
            bias.append(np.sum(weight * mean, axis=0))
            counted = weight**2 - 2.0 * np.reshape(shared, (-1, 1)) * weight
            noise.append(students(counted * variance, freedom))
            misfit.append(miss)
        # the powers, weighted by their likelihood
        likelihood = np.exp(-0.5 * (np.array(misfit) - min(misfit)))
        likelihood /= likelihood.sum()
        middle = likelihood @ np.array(bias)
        between = NORMAL**2 * (np.array(bias) - middle) ** 2
        square = likelihood @ (np.array(noise) ** 2 + between)
        powers.append(float(likelihood @ SIZE_ORDERS))
        size = np.abs(np.nanmean(answer, axis=0))
        biases.append(middle / size)
        rows.append(np.sqrt(square) / size)
    how = f"means over the cell size from {len(ratios)} sizes, power about {np.mean(powers):.2g}"
    return Term(how, np.array(rows), np.array(biases))


def without_bias(response: Dataset, *terms: Term) -> Dataset:
    """Return a response less the biases of gap and contact fraction by terms."""
    gap, area, _ = 1.0 - np.sum([np.asarray(term.bias) for term in terms], axis=0)
    steps, place = response.sizes["step"], normal_observations(response).order
    factors = np.ones((2, steps))
    factors[:, place] = gap, area
    corrected = {
        name: response[name].copy(data=response[name].to_numpy() * factor)
        for name, factor in zip(("mean_gap", "contact_fraction"), factors, strict=True)
    }
    corrected["contact_fraction"] = corrected["contact_fraction"].clip(0.0, 1.0, keep_attrs=True)
    return response.assign(corrected)


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


def _slope(x: np.ndarray, mean: np.ndarray, error: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the weights (sizes, steps) of means in the slope of a line over x, and the misfit."""
    weight, x = 1.0 / error**2, x[:, None]
    centre = (weight * x).sum(axis=0) / weight.sum(axis=0)
    level = (weight * mean).sum(axis=0) / weight.sum(axis=0)
    share = weight * (x - centre) / (weight * (x - centre) ** 2).sum(axis=0)
    slope = (share * mean).sum(axis=0)
    misfit = np.sum(weight * (mean - level - slope * (x - centre)) ** 2, axis=0)
    return share, float(misfit.mean())  # the steps of a cell are not independent


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


def compared(
    response: Dataset, others: Mapping[float, Dataset], *, apart: bool
) -> dict[float, Dataset]:
    """Return compared responses by their ratios, with the response unless ``apart``."""
    if apart and len(others) < 2:
        raise CaseError(
            f"ensembles apart from the response are compared among themselves, so that two are "
            f"needed, got {len(others)}"
        )
    expected = normal_observations(response).pressure
    for ratio, other in others.items():
        p = normal_observations(other).pressure
        if p.size != expected.size or not np.allclose(p, expected, rtol=1e-6):
            raise CaseError(
                f"the response at the ratio {ratio:g} has other pressures; press it as the first"
            )
    return dict(others) if apart else {1.0: response, **others}


def students(variances: np.ndarray, freedom: np.ndarray) -> np.ndarray:
    """Return the 95 % half-width of a sum, by Welch and Satterthwaite, from (terms, steps)."""
    from scipy.special import stdtrit

    total = np.maximum(variances.sum(axis=0), 0.0)
    single = np.sum(variances**2 / np.maximum(freedom, 1), axis=0)
    whole = np.where(single > 0.0, total**2 / np.where(single > 0.0, single, 1.0), np.inf)
    factor = stdtrit(np.maximum(whole, 1.0), 0.975)
    return np.asarray(np.where(np.isfinite(whole), factor, NORMAL) * np.sqrt(total))

"""Conductances and hydraulic apertures of rough interfaces, with bands."""

from collections.abc import Mapping

import numpy as np

from multiscale.schema import INTERFACE_LAW, Dataset, with_cautions
from multiscale.upscaling.branches import ALONG_LOADING, REFUSED
from multiscale.upscaling.budget import estimate_grid_error
from multiscale.upscaling.fit import branch_origins
from multiscale.upscaling.observations import Misfit
from multiscale.upscaling.propagation import Uncertainty
from multiscale.upscaling.reading import area_from_dataset, law_from_dataset, require_law
from multiscale.upscaling.response_observations import loading_branch
from multiscale.upscaling.sampling import draw_counts, half_range, widening

CONDUCTANCES = {"thermal_conductance": "W m-2 K-1", "electrical_conductance": "S m-2"}
"""Conductances of an interface, and their units."""

DIRECTIONS = ("x", "y", "both")
"""Directions of the flow; the last takes the flows along x and y as two realisations."""

FEWEST_WAVES = 4.0
"""Longest wavelengths along a cell below which its percolation depends on chance."""

SAMPLES = 400  # of the cells, for the intervals

SCATTER = (
    "The intervals contain the scatter of the surfaces, but not the error of the grid, without "
    "channels between its points: coarser in [micro] adds this error."
)

SCATTER_AND_GRID = (
    "The intervals contain the scatter of the surfaces, and the error of the grid by a grid with "
    "half of the points."
)

HALVINGS = 60  # of the range of a permeability, in its logarithm


def with_conductance(
    law: Dataset,
    conductivities: Mapping[str, tuple[float, float]],
    contact_modulus: float,
    *,
    flows: bool,
) -> Dataset:
    r"""Return a law with the conductances of its interface, W/(m² K) for heat and S/m² for current.

    Currents through the spots have the harmonic function of a small further displacement [1]_:
    :math:`h(p) = 2 \beta K(p) / (E^* (1/k_1 + 1/k_2))` (1). Currents through the open gap, by
    radiation or a fluid, and films on the spots are not included.

    .. [1] J. R. Barber, Proc. R. Soc. Lond. A 459 (2003) 53-66, doi:10.1098/rspa.2002.1038.
    """
    if not conductivities:
        return law
    unloads = flows and "unloading_stiffness_ratio" in law
    beta = float(law["unloading_stiffness_ratio"]) if unloads else 1.0
    ratios = {
        f"{name}_ratio": 2.0 * beta / (contact_modulus * (1.0 / k1 + 1.0 / k2))  # (1)
        for name, (k1, k2) in conductivities.items()
    }
    law = INTERFACE_LAW.assign(law, ratios).assign_attrs(
        conductance_branch="unloading" if unloads else "loading"
    )
    branch = branch_origins(law).get("unloading", "")
    if not flows or unloads or branch == ALONG_LOADING:
        return law
    advice = "the cells give no such branch" if branch == REFUSED else "set unload in [micro]"
    return with_cautions(
        law,
        f"the conductance follows from the stiffness of loading, but metal that flows is stiffer "
        f"at the start of unloading, so the conductance is too small; {advice}",
    )


def conductances(law: Dataset, pressure: np.ndarray) -> dict[str, np.ndarray]:
    """Return the conductances that a law has, at pressures of the interface, Pa.

    By names of :data:`CONDUCTANCES`, of the shape of the pressures, W m-2 K-1 and S m-2.
    """
    normal = law_from_dataset(law)
    stiffness = normal.stiffness(normal.gap_at(pressure))
    return {name: ratio * stiffness for name, ratio in conductance_ratios(law).items()}


def conductance_ratios(law: Dataset) -> dict[str, float]:
    """Return conductances over the stiffness of loading, W m-1 K-1 Pa-1 and S m-1 Pa-1."""
    names = {name: f"{name}_ratio" for name in CONDUCTANCES}
    return {name: float(law[ratio]) for name, ratio in names.items() if ratio in law.variables}


def elastic_source(law: Dataset, answers: np.ndarray) -> Uncertainty:
    """Return the start of unloading as a source of error of the answers that are conductances.

    ``answers``, shape (answers, steps), is 1 for conductances and 0 for other answers.
    """
    require_law(law, "conductance_branch")
    half = 0.0
    if law.attrs["conductance_branch"] == "unloading":
        half = np.nan
        if law.sizes.get("unloading_sample"):
            drawn = law["unloading_stiffness_ratio_sample"].to_numpy()
            half = float(half_range(drawn) / law["unloading_stiffness_ratio"])
    return Uncertainty(name="start of unloading", half_width={"sampling": half}, rate=1.0 * answers)


def effective_permeability(permeability: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the permeability of an interface as a patchwork of cells, by Bruggeman's theory."""
    opened = permeability > 0.0
    total = weight.sum(axis=1)
    share = np.sum(weight * opened, axis=1) / np.where(total > 0.0, total, np.nan)
    values = permeability[opened] if opened.any() else np.ones(1)
    # with the least permeability in the open share f of the cells, k is (2 f - 1) times as large
    low = np.log(values.min() * np.clip(2.0 * share - 1.0, 1e-12, 1.0))
    high = np.full(share.shape, np.log(values.max()))
    # sum w_i (k_i - k) / (k_i + k) = 0 (1): D. A. G. Bruggeman, Ann. Phys. 416 (1935) 636-664,
    # doi:10.1002/andp.19354160705; exact for a lognormal scatter. Half of random
    # cells are tight where about .42 touches: W. B. Dapp, A. Lücke, B. N. J. Persson, M. H. Müser,
    # Phys. Rev. Lett. 108 (2012) 244301, doi:10.1103/PhysRevLett.108.244301
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        k = np.exp(middle)[:, None]
        rises = np.sum(weight * (permeability - k) / (permeability + k), axis=1) > 0.0  # (1)
        low, high = np.where(rises, middle, low), np.where(rises, high, middle)
    return np.where(share <= 0.5, 0.0, np.exp(0.5 * (low + high)) + 0.0 * share)


def with_leakage(law: Dataset, response: Dataset, coarser: Dataset | None = None) -> Dataset:
    """Return a law with the hydraulic aperture of its interface as a patchwork of its cells."""
    loading = loading_branch(response)
    solved = loading["nominal_pressure"].to_numpy()
    at = [int(np.argmin(np.abs(solved - p))) for p in law["fit_pressure"].to_numpy()]
    aperture = loading["hydraulic_aperture"].to_numpy()[:, at]
    n, sampled = len(aperture), law.sizes.get("sample", 0) > 0
    counts = draw_counts(n, SAMPLES if sampled else 0, int(law.attrs["seed"]))
    weights = np.vstack([np.ones(n), counts])
    mean, band, percolating = [], [], []
    for axes in ([0], [1], [0, 1]):  # in the order of DIRECTIONS
        h = np.concatenate([aperture[..., k] for k in axes])
        first, *drawn = _spread(_patchwork(h, np.tile(weights, len(axes))), n)
        ends = np.percentile(drawn or [first + np.nan], [2.5, 97.5], axis=0)
        # the error of the grid adds to either side
        if coarser is not None:
            coarse = coarser["hydraulic_aperture"].to_numpy()[:, at]
            fine = aperture[: len(coarse)]
            alike = [
                _patchwork(np.concatenate([cells[..., k] for k in axes]))[0]
                for cells in (fine, coarse)
            ]
            grid = estimate_grid_error(alike[0], {2.0: alike[1]}).half_width
            sides = np.array([-1.0, 1.0])[:, None] * np.hypot(ends - first, grid)
            ends = np.maximum(first + sides, 0.0)
        mean.append(first)
        band.append(ends)
        percolating.append(np.sum(h > 0.0, axis=0) / np.maximum(np.isfinite(h).sum(axis=0), 1))
    law = INTERFACE_LAW.assign(
        law.assign_coords(direction=list(DIRECTIONS)),
        {
            "hydraulic_aperture": np.array(mean),
            "hydraulic_aperture_mean_law": np.stack(band, axis=1),
            "percolating_cells": np.array(percolating),
        },
    ).assign_attrs(leakage_intervals=SCATTER if coarser is None else SCATTER_AND_GRID)
    # a caution where the aperture rises with the pressure by more than chance
    both = np.asarray(mean)[-1]
    low, high = np.array(band)[-1]
    least = np.minimum.accumulate(both)
    scale = np.where(both > 0.0, both, 1.0)
    rises = Misfit(
        "the aperture rises as the pressure rises",
        law["fit_pressure"].to_numpy(),
        (both - least) / scale,
        0.25 * (high - low) / scale,
    )
    law = with_cautions(law, *rises.judge("use more realisations, or wider cells"))
    require_law(law, "cell_size", "longest_wave")
    waves = float(law.attrs["cell_size"]) / float(law.attrs["longest_wave"])
    if waves >= FEWEST_WAVES * (1.0 - 1e-9):
        return law
    return with_cautions(
        law,
        f"a cell has {waves:.2g} of the longest wavelengths along its edge, too few for the "
        f"pressure that closes the last path through the gap, at single summits; make it "
        f"{FEWEST_WAVES:g} wavelengths wide or more",
    )


def _patchwork(aperture: np.ndarray, weight: np.ndarray | None = None) -> np.ndarray:
    """Return the hydraulic aperture of an interface of cells, NaN if unknown, (samples, steps)."""
    known = np.isfinite(aperture)
    counted = known[None] if weight is None else weight[..., None] * known
    cube = effective_permeability(np.where(known, aperture, 0.0) ** 3, counted)
    return np.asarray(np.cbrt(cube))


def _spread(aperture: np.ndarray, n: int) -> np.ndarray:
    """Spread samples about the mean, the first row, as Student's; closed gaps stay closed."""
    mean = aperture[0]
    opened = (aperture > 0.0) & (mean > 0.0)
    ratio = np.divide(aperture, mean, out=np.ones_like(aperture), where=opened)
    return np.where(opened, mean * ratio ** widening(n - 1, n=n), aperture)


def sealing_pressures(law: Dataset, direction: str = "both") -> np.ndarray:
    """Return the pressures between which the last path through an interface closes."""
    require_law(law, "hydraulic_aperture")
    tight = law["hydraulic_aperture"].sel(direction=direction).to_numpy() == 0.0
    pressure = np.concatenate([[np.nan], law["fit_pressure"].to_numpy(), [np.nan]])
    last = int(np.max(np.flatnonzero(~tight) + 1, initial=0))
    return np.asarray(pressure[last : last + 2])


def say_sealing(law: Dataset, direction: str = "both") -> str:
    """Write the pressures between which an interface becomes tight, and the scatter of cells."""
    pressure = law["fit_pressure"].to_numpy()
    last, first = sealing_pressures(law, direction)
    if np.isnan(first):
        return f"Paths lead through the gap up to the highest pressure, {1e-6 * last:.4g} MPa."
    touching = 100.0 * float(area_from_dataset(law).contact_fraction(first))
    before = f"leaks at {1e-6 * last:.4g} MPa and " if np.isfinite(last) else ""
    sentence = (
        f"The interface {before}is tight from {1e-6 * first:.4g} MPa on, where {touching:.3g} % of "
        f"it touches and half of the cells or more have no path."
    )
    cells = law["percolating_cells"].sel(direction=direction).to_numpy()
    mixed = [f"{1e-6 * p:.4g}" for p in pressure[(cells > 0.0) & (cells < 1.0)]]
    if not mixed:
        return sentence
    return f"{sentence} Some cells are tight and others open at {', '.join(mixed)} MPa."

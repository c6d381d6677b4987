"""Separation of the scales, and roughness of a surface at large that its cells lack."""

from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import Dataset
from multiscale.units import readable
from multiscale.upscaling.budget import Term
from multiscale.upscaling.reading import area_from_dataset, law_from_dataset

FARTHEST_CELL = 1.0  # cell over macro length
LEAST_SHARE = 0.5
"""Share of height or slope below which a law would be read at less than half its pressures."""


@dataclass(frozen=True)
class ScaleSeparation:
    r"""Ratios of the scales, with cautions."""

    wavelength_ratio: float  # longest wavelength over macro length
    cell_ratio: float  # edge of the cell over the extent of the structure
    cautions: tuple[str, ...]  # of scales that are not separate

    def __str__(self) -> str:
        """Return the report as text."""
        head = (
            f"longest wavelength {self.wavelength_ratio:.3g} of the length over which the pressure "
            f"varies, cell {self.cell_ratio:.3g} of the interface"
        )
        return "; ".join([head, *self.cautions])

    def count_cells(self) -> str:
        """Write the number of cells of the interface."""
        return f"scatter of single cells; the interface contains {self.cell_ratio**-2.0:.3g}"


def compare_scales(
    wavelength: float, cell_size: float, macro_length: float, *, extent: float | None = None
) -> ScaleSeparation:
    """Compare the scales of a cell and of the structure."""
    whole = macro_length if extent is None else extent
    lengths = {"wavelength": wavelength, "cell_size": cell_size, "macro_length": macro_length}
    for name, value in {**lengths, "extent": whole}.items():
        if not (value > 0.0 and np.isfinite(value)):
            raise CaseError(f"{name} must be positive and finite, got {value:g}")
    cautions = []
    if cell_size / macro_length > FARTHEST_CELL:
        length, cell = (readable(f"{size:.3g} m") for size in (macro_length, cell_size))
        cautions.append(
            f"the interface is {length} wide, less than the cell of {cell}: it has edges, unlike "
            f"periodic cells; use smaller cells, or a wider interface"
            if extent is None
            else f"the pressure varies over {length}, less than the cell of {cell}: no point of "
            f"the structure is loaded like the cell; resolve the longest wavelengths in the "
            f"structure, and the shorter wavelengths in the cell"
        )
    return ScaleSeparation(wavelength / macro_length, cell_size / whole, tuple(cautions))


def effective_cells(weight: np.ndarray, area: np.ndarray, cell_size: float) -> np.ndarray:
    """Count the independent cells over which an answer of an interface averages."""
    # n = (∫ w dA)² / (a ∫ w² dA) (1) for the relative scatter c / sqrt n of an answer with the
    # weight w and the coefficient of variation c of the mean over a cell a; shorter variations make
    # n too small
    square = np.sum(weight**2 * area, axis=-1)
    whole = np.sum(weight * area, axis=-1)
    return np.asarray(whole**2 / np.where(square > 0.0, cell_size**2 * square, np.nan))


def cell_share(cell_size: float, extent: float) -> str:
    """Write the size of a cell relative to the interface; both edges in m."""
    return (
        f"A cell of {1e3 * cell_size:.4g} mm is {cell_size / extent:.2g} of the edge of the "
        f"interface, {1e3 * extent:.4g} mm."
    )


def pressure_length_of_points(
    position: np.ndarray, pressure: np.ndarray, area: np.ndarray
) -> float:
    """Return the length sqrt(∫ p² / ∫ |grad p|²) over which a pressure at points varies, m."""
    from scipy.spatial import cKDTree

    count = min(9, len(position))
    if count < 5:
        raise CaseError(f"a pressure length needs at least 5 points, got {count}")
    _, near = cKDTree(position).query(position, k=count)
    offset = position[near] - position[:, None]
    scale = float(np.max(np.abs(offset)))
    rows = np.concatenate([np.ones((*near.shape, 1)), offset / scale], axis=2)
    # gradient of the best plane through a point and its eight neighbours
    plane = np.einsum("pij,pj->pi", np.linalg.pinv(rows), pressure[near])
    square = float(np.sum(area * np.sum((plane[:, 1:] / scale) ** 2, axis=1)))
    mean = float(np.sum(area * pressure**2))
    extent = float(np.ptp(position))
    return float(np.sqrt(mean / square)) if square > 1e-12 * mean / extent**2 else float(np.inf)


def at_rms_height(response: Dataset, rms_height: float) -> Dataset:
    r"""Return a response with the gaps for another rms height of the surfaces.

    Parameters
    ----------
    response : Dataset, follows ``MICRO_RESPONSE``, with the ``rms_height`` of every realisation
    rms_height : float
        Root mean square height of the whole surface, m, for instance of many of the longest
        wavelengths, without a solution. It becomes the attribute ``gaps_at_rms_height``.

    Raises
    ------
    CaseError
        If the height is not positive, or the response has no heights.

    Notes
    -----
    Small periodic cells have few long wavelengths, and their root mean square height :math:`h_k` is
    not the height :math:`h` of the surface. At equal slope, gaps are proportional to the heights,
    so :math:`g_k\, h / h_k` has less bias and less scatter. The remaining bias falls with the size
    of the cell.
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
    """Estimate the half-widths from the height and slope of measured maps that the cells lack."""
    if "body_rms_height" not in response:
        nothing = np.zeros((3, p.size))
        return Term("nothing: the surfaces of the cells are not windows of maps", nothing)
    shares = []  # of height and slope; squares of independent bodies add
    for name in ("rms_height", "rms_slope"):
        body = response[f"body_{name}"]
        lost = body.sel(stage="map").to_numpy() ** 2 - body.sel(stage="cells").to_numpy() ** 2
        square = float(np.mean(response[name].to_numpy() ** 2))
        # windows rougher than their map have no missing roughness
        shares.append(float(np.sqrt(square / (square + np.sum(np.maximum(lost, 0.0))))))
    height, slope = shares
    how = f"the cells have {height:.3g} of the rms height and {slope:.3g} of the rms slope"
    if min(shares) < LEAST_SHARE:
        unknown = np.full((3, p.size), np.nan)
        return Term(f"not known: {how}, too little for an estimate of the rest", unknown)
    # cells with shares s_h of the height and s_g of the slope stand, at equal form of the spectrum,
    # for gap(s_g p) / s_h, A(s_g p) and s_h k(s_g p) / s_g; changes are added, and count twice for
    # the form
    mean_law, area_law = law_from_dataset(law), area_from_dataset(law)
    gap, area = mean_law.gap_at, area_law.contact_fraction
    similar = mean_law.stiffness(gap(slope * p)) / slope
    rows = [
        1.0 / height - 1.0 + np.abs(gap(slope * p) / gap(p) - 1.0),
        np.abs(area(slope * p) / area(p) - 1.0),
        1.0 - height + np.abs(similar / mean_law.stiffness(gap(p)) - 1.0),
    ]
    return Term(how, 2.0 * np.array(rows))

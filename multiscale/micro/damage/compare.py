"""Geometric damage of a volume beside its stiffness."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.io.images import VoxelImage
from multiscale.laws.bulk.moduli import youngs_modulus_along
from multiscale.micro.damage.cavities import Cavities
from multiscale.micro.damage.rve import STRAINS, effective_stiffness
from multiscale.schema import RVE_STIFFNESS

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["compare_stiffness", "section_image"]


def compare_stiffness(
    image: VoxelImage,
    sections: "xr.Dataset",
    youngs_modulus: float,
    poissons_ratio: float,
    *,
    tolerance: float = 1e-4,
) -> "xr.Dataset":
    """Compute Young's modulus along every normal beside the damage of its worst section.

    Parameters
    ----------
    image : VoxelImage
    sections : Dataset, follows ``DAMAGE_SECTIONS``, of the same volume
    youngs_modulus, poissons_ratio, tolerance : float, as of :func:`~.rve.effective_stiffness`

    Returns
    -------
    Dataset
        Follows ``RVE_STIFFNESS``.

    Raises
    ------
    ConvergenceError
        If the computation of the stiffness does not converge.
    """
    solution = effective_stiffness(image, youngs_modulus, poissons_ratio, tolerance=tolerance)
    stiffness = solution.unwrap()
    normals = sections["normal"].values
    return RVE_STIFFNESS.build(
        {
            "stiffness": stiffness,
            "strain": list(STRAINS),
            "other_strain": list(STRAINS),
            "normal": normals,
            "modulus_ratio": youngs_modulus_along(stiffness, normals) / youngs_modulus,
            "damage": sections["damage"].values.max(axis=1),
            "porosity": image.porosity,
        },
        youngs_modulus=youngs_modulus,
        poissons_ratio=poissons_ratio,
    )


def section_image(
    rve: Cavities | VoxelImage, origin: np.ndarray, frame: np.ndarray, points: int = 400
) -> tuple[np.ndarray, np.ndarray]:
    """Sample a plane section for a figure.

    Parameters
    ----------
    rve : Cavities or VoxelImage
    origin : ndarray, shape (3,), point of the plane, m
    frame : ndarray, shape (2, 3), orthonormal directions in the plane
    points : int

    Returns
    -------
    along : ndarray, shape (points,)
        Coordinates in the plane along both directions, m.
    value : ndarray, shape (points, points)
        0 in solid, 1 in void, NaN outside the box; the first axis is the second direction.
    """
    size = np.array(rve.size)
    half = 0.5 * float(np.linalg.norm(size))
    along = half * (2.0 * (np.arange(points) + 0.5) / points - 1.0)
    place = origin[:, None, None] + (
        frame[0][:, None, None] * along[None, None, :]
        + frame[1][:, None, None] * along[None, :, None]
    )
    inside = np.all((place >= 0.0) & (place < size[:, None, None]), axis=0)
    void = np.zeros((points, points), dtype=bool)
    if isinstance(rve, Cavities):
        for kind in rve.images:
            for k in range(len(kind.centre)):
                void |= kind.contains(k, place, 4.0 * half / points)
    else:
        index = np.floor(place / np.array(rve.spacing)[:, None, None]).astype(int)
        index = np.clip(index, 0, np.array(rve.void.shape)[:, None, None] - 1)
        void = rve.void[tuple(index)]
    return along, np.where(inside, void.astype(float), np.nan)

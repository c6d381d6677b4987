"""Layers of other materials on a body: where they lie, and which planes of a mesh follow them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk.moduli import check_moduli

__all__ = ["Coating", "coating_faces", "elements_of", "follow_faces", "moduli_by_layer"]


@dataclass(frozen=True)
class Coating:
    """One elastic layer of even thickness on a body, bonded to the material below.

    Parameters
    ----------
    thickness : float
        m.
    youngs_modulus, poissons_ratio : float
        Pa and 1.

    Raises
    ------
    CaseError
        If a parameter is outside its range.
    """

    thickness: float
    youngs_modulus: float
    poissons_ratio: float

    def __post_init__(self) -> None:
        if not 0.0 < self.thickness < np.inf:
            raise CaseError(
                f"the thickness of a coating must be positive (m), got {self.thickness:g}"
            )
        check_moduli(self.youngs_modulus, self.poissons_ratio, least=0.0)


def coating_faces(coating: Sequence[Coating], depth: float) -> np.ndarray:
    """Heights of the lower faces of coatings, outermost first, above the base of a body, m."""
    faces = depth - np.cumsum([one.thickness for one in coating])
    if faces.size and not faces[-1] > 0.0:
        raise CaseError(
            f"the coatings are {depth - faces[-1]:.3g} m thick, and the depth of {depth:.3g} m "
            f"leaves nothing of the body below; raise the depth"
        )
    return np.asarray(faces)


def follow_faces(planes: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Move the nearest of the inner planes of a mesh onto each face, all m."""
    nearest = 1 + np.argmin(np.abs(planes[1:-1] - faces[:, None]), axis=1)
    if np.any(np.diff(nearest) == 0):
        raise CaseError(
            f"of {faces.size} coatings, one gets 0 of the {planes.size - 1} layers of elements: it "
            f"is thinner than an element there; raise layers, or join coatings"
        )
    moved = planes.copy()
    moved[nearest] = faces
    return moved


def elements_of(coating: Sequence[Coating], planes: np.ndarray) -> list[int]:
    """Count the layers of elements of each coating between planes that follow its faces."""
    faces = coating_faces(coating, float(planes[-1]))
    index = np.searchsorted(planes, np.concatenate([planes[-1:], faces]) * (1.0 - 1e-12))
    return [int(count) for count in -np.diff(index)]


def moduli_by_layer(
    coating: Sequence[Coating], below: tuple[float, float], planes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Young's moduli, Pa, and Poisson's ratios of the layers between planes, from the base up.

    ``below`` are the moduli of the body below its coatings.
    """
    middle = 0.5 * (planes[1:] + planes[:-1])
    place = np.searchsorted(coating_faces(coating, float(planes[-1]))[::-1], middle)
    pairs = [below, *((one.youngs_modulus, one.poissons_ratio) for one in coating[::-1])]
    modulus, ratio = np.array(pairs)[place].T
    return modulus, ratio

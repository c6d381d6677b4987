"""What is pressed against what, and how: the cell and its load path."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from multiscale.errors import CaseError
from multiscale.io.surfaces import Surface

if TYPE_CHECKING:
    from skfem import Element, Mesh

__all__ = ["Cell", "MeshCell", "Path", "contact_modulus", "lame_parameters"]


def contact_modulus(*bodies: tuple[float, float]) -> float:
    r"""Contact modulus :math:`1/E^* = \sum (1-\nu_i^2)/E_i`, Pa.

    Parameters
    ----------
    *bodies : tuple of float
        Young's modulus, Pa, and Poisson's ratio of each body.

    Examples
    --------
    >>> round(contact_modulus((210e9, 0.3), (210e9, 0.3)) / 1e9, 3)
    115.385
    """
    return 1.0 / sum((1.0 - nu**2) / modulus for modulus, nu in bodies)


def lame_parameters(
    youngs_modulus: float | np.ndarray, poissons_ratio: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lame's parameters (lambda, mu) of an isotropic material, Pa."""
    modulus, nu = np.asarray(youngs_modulus), np.asarray(poissons_ratio)
    return modulus * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), modulus / (2.0 * (1.0 + nu))


def _check_material(youngs_modulus: float | np.ndarray, poissons_ratio: float) -> None:
    if not np.all(np.isfinite(youngs_modulus)) or not np.all(np.asarray(youngs_modulus) > 0.0):
        raise CaseError(
            f"Young's modulus must be positive and finite (Pa), got {np.min(youngs_modulus):g}"
        )
    if not 0.0 <= poissons_ratio < 0.5:
        raise CaseError(
            f"Poisson's ratio must be at least 0 and below 0.5, got {poissons_ratio:g}; "
            f"use 0.499 for an incompressible material"
        )


@dataclass(frozen=True, eq=False)
class Cell:
    """A periodic elastic layer whose top is a graph, pressed by a rigid obstacle.

    Parameters
    ----------
    surface : Surface
        Heights of the top; for two rough bodies those of the composite surface.
    depth : float
        Distance from the clamped base to the mean plane of the top, m.
    layers : int
        Layers of elements, graded towards the top.
    youngs_modulus, poissons_ratio : float
        Pa and 1. For two bodies, a material with their contact modulus.
    obstacle : Surface, optional
        Underside of the rigid obstacle on the same grid; a flat if not given. Contact acts along
        its normal.
    geometry : {"conforming", "flat"}
        Whether the mesh follows the surface, or the surface only makes the gap above a flat layer:
        fast, and right for small slopes.

    Raises
    ------
    CaseError
        If a parameter is outside its range or the obstacle has another grid.
    """

    surface: Surface
    depth: float
    layers: int
    youngs_modulus: float
    poissons_ratio: float
    obstacle: Surface | None = None
    geometry: Literal["conforming", "flat"] = "conforming"

    def __post_init__(self) -> None:
        _check_material(self.youngs_modulus, self.poissons_ratio)
        if self.geometry not in ("conforming", "flat"):
            raise CaseError(f"geometry must be 'conforming' or 'flat', got {self.geometry!r}")
        if not self.depth > 0.0:
            raise CaseError(f"the depth of the cell must be positive (m), got {self.depth:g}")
        if self.layers < 2:
            raise CaseError(f"the cell needs at least 2 layers, got {self.layers}")
        if self.obstacle is not None and (
            self.obstacle.heights.shape != self.surface.heights.shape
            or self.obstacle.size != self.surface.size
        ):
            raise CaseError(
                f"the obstacle must have the grid of the surface, "
                f"{self.surface.heights.shape} points on {self.surface.size} m, got "
                f"{self.obstacle.heights.shape} on {self.obstacle.size} m; resample it"
            )

    @property
    def layer_moduli(self) -> tuple[np.ndarray, np.ndarray]:
        """Lame's parameters (lambda, mu) of each layer, Pa."""
        lame, shear = lame_parameters(self.youngs_modulus, self.poissons_ratio)
        return np.full(self.layers, float(lame)), np.full(self.layers, float(shear))

    @property
    def nearly_incompressible(self) -> bool:
        """Whether B-bar is used, and the tilt that keeps its preconditioner good."""
        return self.poissons_ratio >= 0.4


@dataclass(frozen=True, eq=False)
class MeshCell:
    """An elastic body on any scikit-fem mesh, pressed by a rigid obstacle: the general path.

    Parameters
    ----------
    mesh : Mesh
        Three-dimensional, with boundaries named ``"base"`` (clamped), ``"top"`` (contact) and
        ``"sides"``.
    element : Element
        Scalar element for each displacement component, for instance ``ElementTetP2()``.
    youngs_modulus : float or ndarray, shape (elements,)
        Pa.
    poissons_ratio : float
        1.
    periodic : bool
        Whether opposite sides move together (their nodes must match) or slide in their plane.
    obstacle : Surface, optional
        Underside of the rigid obstacle; a flat if not given.
    """

    mesh: "Mesh"
    element: "Element"
    youngs_modulus: float | np.ndarray
    poissons_ratio: float
    periodic: bool = True
    obstacle: Surface | None = None

    def __post_init__(self) -> None:
        _check_material(self.youngs_modulus, self.poissons_ratio)
        found = sorted(self.mesh.boundaries or {})
        missing = sorted({"base", "top", "sides"} - set(found))
        if missing:
            raise CaseError(f"the mesh has no boundary named {missing}; found {found}")
        if np.ndim(self.youngs_modulus) and np.shape(self.youngs_modulus) != (self.mesh.nelements,):
            raise CaseError(
                f"give one Young's modulus or one per element ({self.mesh.nelements}), got "
                f"{np.shape(self.youngs_modulus)}"
            )


@dataclass(frozen=True, eq=False)
class Path:
    """A sequence of load steps, each started from the one before.

    Parameters
    ----------
    pressure : tuple of float, optional
        Mean pressure at each step, Pa, at least 0.
    approach : tuple of float, optional
        Approach of the obstacle counted from the first touch, m. Give one of the two.

    Raises
    ------
    CaseError
        If both or neither are given, or a value is refused.
    """

    pressure: tuple[float, ...] | None = None
    approach: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if (self.pressure is None) == (self.approach is None):
            raise CaseError("a path prescribes either pressures or approaches; give one of them")
        name = "approach" if self.pressure is None else "pressure"
        steps = tuple(float(value) for value in getattr(self, name))
        if not steps or not np.all(np.isfinite(steps)):
            raise CaseError(f"a path needs at least one step and finite values, got {steps}")
        if self.pressure is not None and min(steps) < 0.0:
            raise CaseError(
                f"pressures must not be negative (Pa), got {min(steps):g}; adhesion is not modelled"
            )
        object.__setattr__(self, name, steps)

    def __len__(self) -> int:
        return len(self.pressure or self.approach or ())

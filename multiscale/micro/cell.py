"""What is pressed against what: the cell and its material."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk import J2, BulkLaw, NeoHookean, Prony
from multiscale.laws.bulk.moduli import lame_parameters
from multiscale.micro import bonded_layer
from multiscale.surfaces.surface import Surface

if TYPE_CHECKING:
    from skfem import Element, Mesh

__all__ = [
    "Cell",
    "MeshCell",
    "Opposite",
    "depth_caution",
]


def depth_caution(depth: float, period: float) -> str | None:
    """Return what a layer thinner than the period does to the answer, if it is."""
    if depth >= 0.99 * period:
        return None
    share = float(bonded_layer.ratio_bonded(np.array(2.0 * np.pi * depth / period), 0.3))
    return (
        f"a depth of {depth:.3g} m below a period of {period:.3g} m makes the longest wave "
        f"{100.0 * (1.0 - share):.2g} % too stiff"
    )


def _check_material(youngs_modulus: float | np.ndarray, poissons_ratio: float | np.ndarray) -> None:
    modulus, nu = np.asarray(youngs_modulus), np.asarray(poissons_ratio)
    wrong = modulus[~((modulus > 0.0) & np.isfinite(modulus))]
    if wrong.size:
        raise CaseError(f"Young's modulus must be positive and finite (Pa), got {wrong[0]:g}")
    wrong = nu[~((nu >= 0.0) & (nu < 0.5))]
    if wrong.size:
        raise CaseError(
            f"Poisson's ratio must be at least 0 and below 0.5, got {wrong[0]:g}; "
            f"use 0.499 for an incompressible material"
        )


@dataclass(frozen=True, eq=False)
class Opposite:
    """What makes the obstacle a deformable body: a layer behind its underside.

    Parameters
    ----------
    depth : float
        Distance from its clamped base to the mean plane of its underside, m.
    layers : int
        Layers of elements, graded towards the underside.
    youngs_modulus, poissons_ratio : float
        Pa and 1.
    bulk : NeoHookean, J2 or Prony, optional
        Law at large strain, with the moduli above; small strain if not given.
    """

    depth: float
    layers: int
    youngs_modulus: float
    poissons_ratio: float
    bulk: BulkLaw | None = None


@dataclass(frozen=True, eq=False)
class Cell:
    """A periodic layer whose top is a graph, pressed by a rigid obstacle or a second body.

    Parameters
    ----------
    surface : Surface
        Heights of the top; for two rough bodies those of the composite surface.
    depth : float
        Distance from the clamped base to the mean plane of the top, m.
    layers : int
        Layers of elements, graded towards the top.
    youngs_modulus, poissons_ratio : float or ndarray
        Pa and 1: of the whole cell, of each layer from the base up, shape (layers,), or of each
        element, shape (nx, layers, ny). For two bodies, a material with their contact modulus.
    obstacle : Surface, optional
        Underside of the rigid obstacle on the same grid; a flat if not given. Contact acts along
        its normal.
    geometry : {"conforming", "flat"}
        Whether the mesh follows the surface, or the surface only makes the gap above a flat layer:
        fast, and right for small slopes.
    hardness : float, optional
        Largest local pressure of a flat cell, Pa: the cheap plastic limit.
    bulk : NeoHookean, J2 or Prony, optional
        Law at large strain, with the moduli above; small strain if not given.
    friction_coefficient : float
        Of the local Coulomb law between the body and the obstacle.
    opposite : Opposite, optional
        Makes the obstacle deformable; contact is then that of the current configuration, and the
        obstacle may have another grid on the same area.

    Raises
    ------
    CaseError
        If a parameter is outside its range or the obstacle has another grid.
    """

    surface: Surface
    depth: float
    layers: int
    youngs_modulus: float | np.ndarray
    poissons_ratio: float | np.ndarray
    obstacle: Surface | None = None
    geometry: Literal["conforming", "flat"] = "conforming"
    hardness: float | None = None
    bulk: BulkLaw | None = None
    friction_coefficient: float = 0.0
    opposite: Opposite | None = None

    def __post_init__(self) -> None:
        _check_material(self.youngs_modulus, self.poissons_ratio)
        self._check_shapes()
        self._check_bulk()
        if self.geometry not in ("conforming", "flat"):
            raise CaseError(f"geometry must be 'conforming' or 'flat', got {self.geometry!r}")
        if not self.depth > 0.0:
            raise CaseError(f"the depth of the cell must be positive (m), got {self.depth:g}")
        if self.layers < 2:
            raise CaseError(f"the cell needs at least 2 layers, got {self.layers}")
        if self.opposite is not None:
            self._check_opposite()
        elif self.obstacle is not None and (
            self.obstacle.heights.shape != self.surface.heights.shape
            or self.obstacle.size != self.surface.size
        ):
            raise CaseError(
                f"the obstacle must have the grid of the surface, "
                f"{self.surface.heights.shape} points on {self.surface.size} m, got "
                f"{self.obstacle.heights.shape} on {self.obstacle.size} m; resample it"
            )

    def _check_shapes(self) -> None:
        """Refuse moduli of another shape than layers or elements, and a misplaced hardness."""
        nx, ny = self.surface.heights.shape
        for name, value in (
            ("youngs_modulus", self.youngs_modulus),
            ("poissons_ratio", self.poissons_ratio),
        ):
            if np.shape(value) not in ((), (self.layers,), (nx, self.layers, ny)):
                raise CaseError(
                    f"{name} must be one number, one of each layer ({self.layers},) or one of each "
                    f"element ({nx}, {self.layers}, {ny}), got shape {np.shape(value)}"
                )
        if self.geometry == "flat" and self.heterogeneous:
            raise CaseError(
                "a flat cell has one modulus in each layer, not in each element; use the "
                "conforming geometry"
            )
        if self.hardness is not None and self.geometry != "flat":
            raise CaseError("a hardness caps the pressure of a flat cell only; use geometry='flat'")
        if self.hardness is not None and not 0.0 < self.hardness < np.inf:
            raise CaseError(f"the hardness must be positive (Pa), got {self.hardness:g}")

    def _check_bulk(self) -> None:
        """Refuse a law or friction that the geometry or the moduli do not agree with."""
        mu = self.friction_coefficient
        if not 0.0 <= mu < np.inf:
            raise CaseError(f"the friction coefficient must not be negative, got {mu:g}")
        if self.geometry == "flat" and (self.bulk is not None or mu > 0.0):
            raise CaseError(
                "a flat cell has neither friction nor a law at large strain; use the conforming "
                "geometry"
            )
        if self.bulk is None:
            return
        if not isinstance(self.bulk, NeoHookean | J2 | Prony):
            raise CaseError(
                f"a cell takes NeoHookean, J2 or Prony as its law at large strain, got "
                f"{type(self.bulk).__name__}; leave bulk out for linear elasticity"
            )
        for name in ("youngs_modulus", "poissons_ratio"):
            own, law = getattr(self, name), getattr(self.bulk, name)
            if not np.all(np.isclose(own, law, rtol=1e-12, atol=0.0)):
                raise CaseError(
                    f"{name} of the bulk law is {law:g}, that of the cell {np.ravel(own)[0]:g}; "
                    f"give the same, and one for the whole cell"
                )

    def _check_opposite(self) -> None:
        """Refuse a second body of another size, or one that could not be a cell itself."""
        if self.geometry == "flat":
            raise CaseError(
                "a flat cell has no second body; use the conforming geometry, or the composite "
                "surface and a material with the contact modulus of both"
            )
        if self.obstacle is not None and self.obstacle.size != self.surface.size:
            raise CaseError(
                f"both bodies need the same area, the first has {self.surface.size} m, the "
                f"opposite {self.obstacle.size} m; crop or repeat one"
            )
        if (
            self.obstacle is not None
            and min(
                own - other
                for own, other in zip(
                    self.surface.heights.shape, self.obstacle.heights.shape, strict=True
                )
            )
            < 0
        ):
            raise CaseError(
                f"contact is decided at the nodes of the first body, which has "
                f"{self.surface.heights.shape} points, fewer than the opposite body with "
                f"{self.obstacle.heights.shape}; exchange them or resample one"
            )
        try:
            self.opposite_cell  # noqa: B018  checks itself
        except CaseError as error:
            raise CaseError(f"the opposite body: {error}") from error

    @property
    def opposite_cell(self) -> "Cell":
        """The opposite body as a cell, in its own frame: its z points out of its surface."""
        if self.opposite is None:
            raise ValueError("the obstacle of this cell is rigid")
        under, body = self.obstacle, self.opposite
        heights = np.zeros_like(self.surface.heights) if under is None else -under.heights
        return Cell(
            Surface(heights, self.surface.size),
            body.depth,
            body.layers,
            body.youngs_modulus,
            body.poissons_ratio,
            bulk=body.bulk,
        )

    @property
    def bodies(self) -> tuple["Cell", ...]:
        """The deformable bodies."""
        return (self,) if self.opposite is None else (self, self.opposite_cell)

    @property
    def heterogeneous(self) -> bool:
        """Whether moduli vary within a layer."""
        return max(np.ndim(self.youngs_modulus), np.ndim(self.poissons_ratio)) > 1

    @property
    def moduli(self) -> tuple[np.ndarray, np.ndarray]:
        """Lame's parameters (lambda, mu) of each layer or element, Pa."""

        def spread(value: float | np.ndarray) -> np.ndarray:
            array = np.asarray(value, dtype=float)
            if self.heterogeneous and array.ndim == 1:
                array = array[:, None]
            nx, ny = self.surface.heights.shape
            shape = (nx, self.layers, ny) if self.heterogeneous else (self.layers,)
            return np.broadcast_to(array, shape)

        return lame_parameters(spread(self.youngs_modulus), spread(self.poissons_ratio))

    @property
    def layer_moduli(self) -> tuple[np.ndarray, np.ndarray]:
        """Lame's parameters (lambda, mu) of each layer, Pa; the mean over its elements."""
        lame, shear = self.moduli
        if self.heterogeneous:
            return lame.mean(axis=(0, 2)), shear.mean(axis=(0, 2))
        return lame, shear

    @property
    def nearly_incompressible(self) -> bool:
        """Whether B-bar is used, and the tilt that keeps its preconditioner good."""
        return float(np.max(self.poissons_ratio)) >= 0.4

    def cautions(self) -> list[str]:
        """Return what a user should know before trusting the results, one sentence each."""
        period = max(self.surface.size)
        found = [depth_caution(body.depth, period) for body in self.bodies]
        return [caution for caution in found if caution]


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

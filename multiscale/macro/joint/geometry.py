"""What a rough joint is made of."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.bulk import AnisotropicElastic, Elastic

if TYPE_CHECKING:
    from skfem import Element

__all__ = ["Block", "RoughJoint", "soften"]


@dataclass(frozen=True)
class Block:
    """One elastic block of a joint.

    Parameters
    ----------
    height : float, height, m
    youngs_modulus : float, Pa
    poissons_ratio : float, dimensionless
    layers : int, default 4, number of elements over the height
    effective : AnisotropicElastic, optional
        Elasticity of the block where cavities or cracks make it differ from the elasticity of its
        solid, whose moduli then count no more; see :func:`soften`.

    Raises
    ------
    CaseError
        If a parameter is outside its range.
    """

    height: float
    youngs_modulus: float
    poissons_ratio: float
    layers: int = 4
    effective: AnisotropicElastic | None = None

    @property
    def law(self) -> Elastic | AnisotropicElastic:
        """Elasticity of the block."""
        return self.effective or Elastic(self.youngs_modulus, self.poissons_ratio)

    @property
    def shear_compliance(self) -> float:
        """Displacement under an even shear along its face and no bending, m/Pa: h/G."""
        return 2.0 * (1.0 + self.poissons_ratio) * self.height / self.youngs_modulus

    @property
    def compliance(self) -> float:
        """Shortening under an even pressure along z and no other stress, m/Pa."""
        if self.effective is None:
            return self.height / self.youngs_modulus
        return self.height * float(np.linalg.inv(self.effective.stiffness)[2, 2])

    def __post_init__(self) -> None:
        if not self.height > 0.0:
            raise CaseError(f"height of a block must be positive (m), got {self.height:g}")
        if not self.youngs_modulus > 0.0:
            raise CaseError(
                f"youngs_modulus of a block must be positive (Pa), got {self.youngs_modulus:g}"
            )
        if not -1.0 < self.poissons_ratio < 0.5:
            raise CaseError(
                f"poissons_ratio of a block must lie between -1 and 0.5, "
                f"got {self.poissons_ratio:g}"
            )
        if self.layers < 1:
            raise CaseError(f"a block needs at least one layer of elements, got {self.layers}")


@dataclass(frozen=True)
class RoughJoint:
    """Two blocks between frictionless platens, joined by a rough frictionless interface.

    The lower block (side 1) stands on a fixed platen. A rigid platen on the upper block (side 2)
    carries the force, pressure times section.

    Parameters
    ----------
    section : tuple of float, lengths of the nominal contact along x and y, m
    lower, upper : Block, side 1 and side 2
    elements : tuple of int, default (6, 6)
        Number of elements along x and y, the same in both blocks.
    eccentricity : tuple of float, optional
        Where the force acts, measured from the centre along x and y, m. The loaded platen then
        tilts freely. Without it the platen is guided and only moves along z.
    element : Element, optional, scalar scikit-fem element for hexahedra; 8 nodes if not given
    quadrature_order : int, default 3
        Degree that the quadrature of the interface integrates exactly. A joint that opens in
        part wants more.

    Raises
    ------
    CaseError
        If a parameter is outside its range.
    """

    section: tuple[float, float]
    lower: Block
    upper: Block
    elements: tuple[int, int] = (6, 6)
    eccentricity: tuple[float, float] | None = None
    element: "Element | None" = None
    quadrature_order: int = 3

    def __post_init__(self) -> None:
        if not min(self.section) > 0.0:
            raise CaseError(f"section must have positive lengths (m), got {self.section}")
        if min(self.elements) < 1:
            raise CaseError(f"elements must be at least one along x and y, got {self.elements}")
        if self.quadrature_order < 1:
            raise CaseError(f"quadrature_order must be at least 1, got {self.quadrature_order}")
        for arm, length in zip(self.eccentricity or (0.0, 0.0), self.section, strict=True):
            if not abs(arm) < 0.5 * length:
                raise CaseError(
                    f"eccentricity must keep the force inside the section, where |eccentricity| "
                    f"< {0.5 * length:g} m, got {arm:g}"
                )

    @property
    def area(self) -> float:
        """Nominal contact area, m²."""
        return self.section[0] * self.section[1]


def soften(block: Block, stiffness: float | np.ndarray) -> Block:
    """Return a block with less stiffness.

    Parameters
    ----------
    block : Block, sound, or softened before
    stiffness : float or ndarray
        A share of what it was, above 0 and up to 1, such as 1 - D, for all its stiffness alike.
        Or the tensor of a representative volume, shape (6, 6), Pa, whose axes are the axes of the
        joint, in place of its moduli.

    Raises
    ------
    CaseError
        If the share is outside its range, or the volume is cut through.
    """
    if isinstance(stiffness, np.ndarray):
        return replace(block, effective=AnisotropicElastic(stiffness))
    if not 0.0 < stiffness <= 1.0:
        raise CaseError(
            f"the stiffness factor of a block must lie above 0 and up to 1, got {stiffness:g}; a "
            f"block without stiffness carries no joint"
        )
    share = float(stiffness)
    return replace(
        block,
        youngs_modulus=share * block.youngs_modulus,
        effective=block.effective and block.effective.scaled(share),
    )

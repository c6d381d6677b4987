"""Parts that solving a cell may take, with reasons, and the memory of a meshed layer."""

from collections.abc import Mapping
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from multiscale.needs import Choice

if TYPE_CHECKING:
    from multiscale.micro.layer import PeriodicLayer

__all__ = ["AVERAGES", "CellPart", "cell_choices", "layer_memory", "layer_unknowns"]

_LANES = 32  # elements along y in one batch of the kernels
_KRYLOV = 15  # directions, each with its image
_VECTORS = 4  # displacement-sized arrays alive at the peak of a contact solve, the last step's too

AVERAGES = "averages the change of volume over an element, which is too stiff otherwise ({})"


class CellPart(StrEnum):
    """Part of the solution of a cell, in the order of the text, and why it is built or left out.

    A kind of cell can give other reasons.
    """

    why: str
    why_not: str

    def __new__(cls, text: str, why: str, why_not: str) -> "CellPart":
        """Store both reasons with the text."""
        part = str.__new__(cls, text)
        part._value_, part.why, part.why_not = text, why, why_not
        return part

    STIFFNESS = (
        "stiffness",
        "of the elements, applied without a matrix",
        "it changes with the strain, which the tangent follows",
    )
    TANGENT = (
        "tangent",
        "stiffness of the elements as they are strained, in single precision",
        "the material is linear elastic: its stiffness does not change",
    )
    FRICTION = (
        "friction",
        "three unknowns at a node in contact, one normal and two along the surface",
        "without friction a node in contact has one unknown, the normal one",
    )
    FACTORS = (
        "factors",
        "of the stiffness, computed once: the cell is small",
        "the stiffness is applied, or too large for its factors",
    )
    MULTIGRID = (
        "multigrid",
        "the stiffness is too large for factors; coarse spaces hold the rigid motions",
        "the stiffness has factors, or another inverse speeds up the iteration",
    )
    SECOND_BODY = "opposite body", "a second deformable body", "the counterface is rigid"
    LAYER_FACTORS = (
        "layer factors",
        "the solution of the same cell with a flat face, which speeds up the iteration",
        "a flat cell has a closed form for each wavelength of the surface",
    )
    MEAN_DILATATION = (
        "mean dilatation",
        AVERAGES.format("B-bar"),
        "Poisson's ratio below 0.4, or no elements",
    )
    TILT = (
        "tilt",
        "speeds up the iteration where Poisson's ratio is near 0.5",
        "Poisson's ratio below 0.4, or no elements",
    )
    OBSTACLE_NORMALS = (
        "obstacle normals",
        "directions of contact: the counterface is rough or moves",
        "contact acts along z only",
    )
    ELEMENT_MODULI = (
        "element moduli",
        "moduli that differ from element to element",
        "moduli vary at most from layer to layer",
    )
    STRESS_RECOVERY = (
        "stress recovery",
        "means of the stress in the body, in addition to means of the contact forces",
        "the stress is not asked for, or the material is not linear",
    )
    HARDNESS_CAP = (
        "hardness cap",
        "local pressure stays below the hardness",
        "no hardness is given, or the law of the metal has its yield stress",
    )
    COATING = (
        "coating",
        "layers of other materials at the top of a body",
        "every body is of one material, or graded by its law",
    )
    SLOPE_EXPANSION = (
        "slope expansion",
        "compliance to first order in the slopes: six transforms where the flat one has two",
        "the mesh follows the surface, however steep",
    )


def cell_choices(
    built: Mapping[CellPart, bool],
    why: Mapping[CellPart, str] = {},
    why_not: Mapping[CellPart, str] = {},
) -> tuple[Choice, ...]:
    """Choices of all parts, with the reasons of one kind before the usual; others are left out."""
    return tuple(
        Choice(part, why.get(part, part.why), True)
        if built.get(part, False)
        else Choice(part, why_not.get(part, part.why_not), False)
        for part in CellPart
    )


def layer_unknowns(layer: "PeriodicLayer") -> int:
    """Count the displacements of a meshed layer."""
    return int(3 * np.prod(layer.surface.heights.shape) * layer.layers)


def layer_memory(layer: "PeriodicLayer", friction_coefficient: float) -> int:
    """Estimated peak of a meshed layer, byte."""
    nx, ny = layer.surface.heights.shape
    mixed = layer.law.finite_strain and layer.mean_dilatation
    vector = nx * layer.layers * (4 if mixed else 3) * ny
    factors = (nx // 2 + 1) * layer.layers * 12 * (ny // 2 + 1)
    if not layer.law.finite_strain and friction_coefficient == 0.0:
        if layer.nearly_incompressible:  # tilted, in double precision
            return int(8 * ((_VECTORS + 3) * vector + factors))
        return int(8 * ((_VECTORS + 0.5) * vector + 0.5 * factors))
    points = 8 * nx * layer.layers * _LANES * -(-ny // _LANES)
    rows = 24 + 2 * layer.law.n_state if layer.law.finite_strain else 0  # 48 of half the size
    return int(8 * (2 * _KRYLOV * vector + factors + rows * points))

"""The needs of a cell, from its kind and its fields."""

from collections.abc import Mapping
from enum import StrEnum
from functools import singledispatch
from typing import Any

import numpy as np

from multiscale.micro.cell import AnyCell, FiniteCell, FlatCell, GraphCell, MeshCell, PeriodicLayer
from multiscale.needs import Choice, Needs

__all__ = ["CellPart", "cell_needs"]

_LANES = 32  # elements along y in one batch of the kernels
_KRYLOV = 15  # directions, each with its image
_VECTORS = 4  # displacement-sized arrays alive at the peak of a contact solve, the last step's too

# measured s of one core for a load step, for each unknown: within a factor of two or three
_FLAT, _EXPANDED = 1.1e-6, 1.8e-6  # each point counts as an unknown
_ELASTIC, _PAIR, _FLOWING, _MESH = 5.5e-7, 3e-6, 4.5e-5, 4e-5


_MEAN = "averages the change of volume over an element, which is too stiff otherwise ({})"


class CellPart(StrEnum):
    """What solving a cell may take, in the order of the text, and why it is built or left out.

    A kind of cell may say the reason itself.
    """

    why: str
    why_not: str

    def __new__(cls, text: str, why: str, why_not: str) -> "CellPart":
        """Keep both reasons beside the text."""
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
        "a flat cell is known in closed form for each wave of the surface",
    )
    MEAN_DILATATION = (
        "mean dilatation",
        _MEAN.format("B-bar"),
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
        "contact acts along z alone",
    )
    ELEMENT_MODULI = (
        "element moduli",
        "moduli that differ from element to element",
        "moduli vary at most from layer to layer",
    )
    STRESS_RECOVERY = (
        "stress recovery",
        "means of the stress in the body, beside means of the contact forces",
        "nobody asks for the stress, or the material is not linear",
    )
    HARDNESS_CAP = (
        "hardness cap",
        "local pressure stays below the hardness",
        "no hardness is given, or the metal flows by itself",
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


def cell_needs(cell: AnyCell, *, keep_fields: bool = False) -> Needs:
    """Return what solving a cell takes.

    Examples
    --------
    >>> import numpy as np
    >>> from multiscale.micro import Cell, Surface
    >>> cell = Cell(Surface(np.zeros((8, 8)), (1.0, 1.0)), 1.0, 4, 1.0, 0.3, geometry="flat")
    >>> CellPart.STIFFNESS in cell_needs(cell).built
    False
    """
    return _needs(cell, {"fields": ("pressure", "gap") if keep_fields else ()})


def _choices(
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


@singledispatch
def _needs(cell: AnyCell, kept: dict[str, Any]) -> Needs:
    raise TypeError(f"{type(cell).__name__} is no kind of cell")


@_needs.register
def _(cell: FlatCell, kept: dict[str, Any]) -> Needs:
    nx, ny = cell.surface.heights.shape
    return Needs(
        kinematics="small strain, roughness as gap of a flat layer",
        choices=_choices(
            {
                CellPart.HARDNESS_CAP: cell.hardness is not None,
                CellPart.SECOND_BODY: cell.second is not None,
                CellPart.COATING: any(body.coating for body in cell.bodies),
                CellPart.SLOPE_EXPANSION: cell.slope_order == 2,
            },
            why_not={
                CellPart.STIFFNESS: "a flat cell solves on its surface alone",
                CellPart.STRESS_RECOVERY: "a flat cell has no stress field",
                CellPart.SLOPE_EXPANSION: "slopes are taken as small: errors are of their first "
                "order (slope_order)",
            },
        ),
        libraries=("numba",),
        memory=8 * nx * ny * (20 if cell.slope_order == 1 else 32),
        seconds=nx * ny * (_FLAT if cell.slope_order == 1 else _EXPANDED),
        **kept,
    )


@_needs.register
def _(cell: GraphCell, kept: dict[str, Any]) -> Needs:
    return Needs(
        kinematics="small strain, the mesh follows the surface",
        choices=_choices(
            {
                CellPart.STIFFNESS: True,
                CellPart.LAYER_FACTORS: True,
                CellPart.MEAN_DILATATION: cell.mean_dilatation,
                CellPart.TILT: cell.nearly_incompressible,
                CellPart.OBSTACLE_NORMALS: cell.obstacle is not None,
                CellPart.ELEMENT_MODULI: cell.heterogeneous,
                CellPart.COATING: bool(cell.coating),
            }
        ),
        libraries=("numba",),
        memory=_layer_memory(cell, 0.0),
        seconds=_ELASTIC * _unknowns(cell),
        **kept,
    )


@_needs.register
def _(cell: MeshCell, kept: dict[str, Any]) -> Needs:
    from multiscale.micro.mesh.mesh_size import mesh_size

    size, large = mesh_size(cell), cell.law.finite_strain
    mean = cell.law.flows and cell.element.maxdeg <= 3  # of elements of first order
    return Needs(
        unknowns_per_contact=3 if cell.friction_coefficient > 0.0 else 1,
        kinematics=f"{'large' if large else 'small'} strain on a finite-element mesh, rigid "
        f"{'flat' if cell.obstacle is None else 'rough'} obstacle",
        choices=_choices(
            {
                CellPart.STIFFNESS: True,
                CellPart.TANGENT: large,
                CellPart.FRICTION: cell.friction_coefficient > 0.0,
                CellPart.MEAN_DILATATION: mean,
                CellPart.FACTORS: not size.multigrid,
                CellPart.MULTIGRID: size.multigrid,
                CellPart.OBSTACLE_NORMALS: cell.obstacle is not None,
                CellPart.ELEMENT_MODULI: np.ndim(cell.law.youngs_modulus) > 0,
            },
            {
                CellPart.STIFFNESS: "of the elements, as a matrix",
                CellPart.FACTORS: "of Newton's matrix, computed in every iteration"
                if cell.remembers
                else CellPart.FACTORS.why,
                CellPart.TANGENT: "of the elements as they are strained, as a matrix",
                CellPart.MEAN_DILATATION: _MEAN.format("in the energy"),
            },
            {
                CellPart.LAYER_FACTORS: "a matrix is at hand, and has another way to speed up the "
                "iteration",
                CellPart.MEAN_DILATATION: "the element is the user's choice",
            },
        ),
        state_variables=cell.law.history,
        libraries=("numba", "pyamg", "scikit-fem") if size.multigrid else ("numba", "scikit-fem"),
        memory=size.memory,
        seconds=_MESH * size.unknowns,
        **kept,
    )


@_needs.register
def _(cell: FiniteCell, kept: dict[str, Any]) -> Needs:
    laws, mu = [body.law for body in cell.bodies], cell.friction_coefficient
    large, pair = any(law.finite_strain for law in laws), cell.second is not None
    linear = not all(law.finite_strain for law in laws)
    averages = cell.mean_dilatation or cell.flows
    return Needs(
        unknowns_per_contact=3 if mu > 0.0 else 1,
        kinematics="large strain, the mesh follows the surface, contact in the current "
        "configuration"
        if large
        else "small strain, the mesh follows the surface"
        + (", contact in the current configuration" if pair else ""),
        choices=_choices(
            {
                CellPart.STIFFNESS: linear,
                CellPart.TANGENT: large,
                CellPart.FRICTION: mu > 0.0,
                CellPart.SECOND_BODY: pair,
                CellPart.LAYER_FACTORS: True,
                CellPart.MEAN_DILATATION: averages,
                CellPart.TILT: cell.nearly_incompressible and linear,
                CellPart.OBSTACLE_NORMALS: cell.obstacle is not None or pair,
                CellPart.ELEMENT_MODULI: cell.heterogeneous,
                CellPart.COATING: any(body.coating for body in cell.bodies),
            },
            {CellPart.MEAN_DILATATION: _MEAN.format("pressures are unknowns")} if large else {},
        ),
        state_variables=tuple(name for law in laws for name in law.history),
        libraries=("numba",),
        memory=sum(_layer_memory(body, mu) for body in cell.bodies),
        seconds=(_FLOWING if large or cell.flows else _PAIR) * sum(map(_unknowns, cell.bodies)),
        **kept,
    )


def _unknowns(layer: PeriodicLayer) -> int:
    return int(3 * np.prod(layer.surface.heights.shape) * layer.layers)


def _layer_memory(layer: PeriodicLayer, friction_coefficient: float) -> int:
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

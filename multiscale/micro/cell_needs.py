"""What a cell needs, from what it is."""

from dataclasses import replace

from multiscale.laws.bulk import J2, BulkLaw, Prony
from multiscale.micro.cell import Cell, MeshCell
from multiscale.needs import Needs, choose

__all__ = ["cell_needs"]

_LANES = 32  # elements along y in one batch of the kernels
_KRYLOV = 15  # directions, each with its image
_VECTORS = 9  # displacement-sized arrays alive at the peak of a contact solve


def cell_needs(
    cell: Cell | MeshCell, *, keep_fields: bool = False, recover_stress: bool = False
) -> Needs:
    """Return what solving a cell takes.

    Parameters
    ----------
    cell : Cell or MeshCell
    keep_fields, recover_stress : bool
        As in :func:`multiscale.micro.solve_cell`.

    Examples
    --------
    >>> import numpy as np
    >>> from multiscale.micro import Surface
    >>> cell = Cell(Surface(np.zeros((8, 8)), (1.0, 1.0)), 1.0, 4, 1.0, 0.3, geometry="flat")
    >>> "stiffness" in cell_needs(cell)
    False
    """
    graph = cell if isinstance(cell, Cell) else None
    general = graph is None
    flat = graph is not None and graph.geometry == "flat"
    soft = graph is not None and graph.nearly_incompressible
    law = None if graph is None else graph.bulk
    friction = graph is not None and graph.friction_coefficient > 0.0
    pair = graph is not None and graph.opposite is not None
    laws = (law,) if graph is None else tuple(body.bulk for body in graph.bodies)
    large = any(one is not None for one in laws)
    newton = large or friction or pair
    recover_stress = recover_stress and not newton
    state = tuple(name for one in laws for name in _state_variables(one))
    choices = {
        "stiffness": (
            not flat and None in laws,
            "of the elements, " + ("as a matrix" if general else "applied without a matrix"),
            "a flat cell solves on its surface alone"
            if flat
            else "it changes with the strain, which the tangent follows",
        ),
        "tangent": (
            large,
            "stiffness of the elements as they are strained, in single precision",
            "the material is linear elastic: its stiffness does not change",
        ),
        "friction": (
            friction,
            "three unknowns at a node in contact, one normal and two along the surface",
            "without friction a node in contact has one unknown, the normal one",
        ),
        "opposite body": (
            pair,
            "a second deformable body",
            "the counterface is rigid",
        ),
        "layer factors": (
            not flat and not general,
            "the solution of the same cell with a flat face, which speeds up the iteration",
            "a matrix is at hand, and has another way to speed up the iteration"
            if general
            else "a flat cell is known in closed form for each wave of the surface",
        ),
        "mean dilatation": (
            (soft or any(isinstance(one, J2) for one in laws)) and not flat,
            "averages the change of volume over an element, which is too stiff otherwise ("
            + ("F-bar)" if large else "B-bar)"),
            "the element is the user's choice"
            if general
            else "Poisson's ratio below 0.4, or no elements",
        ),
        "tilt": (
            soft and not flat,
            "speeds up the iteration where Poisson's ratio is near 0.5",
            "Poisson's ratio below 0.4, or no elements",
        ),
        "obstacle normals": (
            (cell.obstacle is not None or pair) and not flat,
            "directions of contact: the counterface is rough or moves",
            "contact acts along z alone",
        ),
        "element moduli": (
            graph is not None and graph.heterogeneous,
            "moduli that differ from element to element",
            "moduli vary at most from layer to layer",
        ),
        "stress recovery": (
            recover_stress and not flat,
            "means of the stress in the body, beside those of the contact forces",
            "a flat cell has no stress field"
            if flat
            else "nobody asks for the stress, or the material is not linear",
        ),
        "hardness cap": (
            graph is not None and graph.hardness is not None,
            "local pressure stays below the hardness",
            "no hardness is given, or the metal flows by itself",
        ),
    }
    recovered = choices["stress recovery"][0]
    operators, left_out = choose(choices)
    return Needs(
        unknowns_per_contact=3 if friction else 1,
        kinematics="small strain, roughness as gap of a flat layer"
        if flat
        else "small strain, the mesh follows the surface"
        + (", contact in the current configuration" if pair else "")
        if not large
        else "large strain, the mesh follows the surface, contact in the current configuration",
        operators=operators,
        left_out=left_out,
        state_variables=state,
        fields=("pressure", "gap") if keep_fields else (),
        libraries=("numba", "scikit-fem") if recovered else ("numba",),
        memory=_memory(cell),
    )


def _memory(cell: Cell | MeshCell) -> int:
    """Estimated peak, byte."""
    if isinstance(cell, MeshCell):
        return int(8 * 3 * cell.mesh.nvertices * 81 * 4)  # rows of 81 entries, and factors
    nx, ny = cell.surface.heights.shape
    if cell.geometry == "flat":
        return int(8 * nx * ny * 22)
    if cell.opposite is not None:
        mu = cell.friction_coefficient
        halves = (replace(body, obstacle=None, opposite=None) for body in cell.bodies)
        return sum(_memory(replace(body, friction_coefficient=mu)) for body in halves)
    vector = nx * cell.layers * 3 * ny
    factors = nx * cell.layers * 15 * (ny // 2 + 1)
    if cell.bulk is None and cell.friction_coefficient == 0.0:
        return int(8 * (_VECTORS * vector + factors))
    points = 8 * nx * cell.layers * _LANES * -(-ny // _LANES)
    rows = 0 if cell.bulk is None else 24 + 2 * cell.bulk.n_state  # 48 numbers of half the size
    return int(8 * (2 * _KRYLOV * vector + factors + rows * points))


def _state_variables(law: BulkLaw | None) -> tuple[str, ...]:
    """History that a law keeps at every Gauss point."""
    if isinstance(law, J2):
        return "plastic metric C_p^-1", "accumulated plastic strain"
    if isinstance(law, Prony):
        return "elastic stress", *(f"stress of the branch of {time:g} s" for time in law.times)
    return ()

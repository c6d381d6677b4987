"""Size of a cell on a mesh, told before anything is assembled."""

from dataclasses import dataclass

from multiscale.micro.cell import CellSides, MeshCell

__all__ = ["MOST_FACTORED", "MeshSize", "mesh_size"]

MOST_FACTORED = 20_000
"""Unknowns above which factors of a stiffness in three dimensions fill up, and multigrid is used.

A rough obstacle, sides of uniform traction, metals and friction have factors always.
"""


@dataclass(frozen=True)
class MeshSize:
    """What the stiffness of a cell takes.

    Attributes
    ----------
    unknowns : int, displacements of all nodes
    multigrid : bool, whether multigrid solves contact, in place of factors
    memory : int, estimated peak, byte
    """

    unknowns: int
    multigrid: bool
    memory: int


def mesh_size(cell: MeshCell) -> MeshSize:
    """Count the unknowns of a cell, and choose what solves its contact."""
    from skfem.assembly import Dofs

    unknowns = 3 * int(Dofs(cell.mesh, cell.element).N)
    flat = cell.obstacle is None and cell.sides is not CellSides.TRACTION and not cell.remembers
    multigrid = flat and unknowns > MOST_FACTORED
    row = {4: 45, 8: 81, 10: 85, 27: 110}[
        len(cell.element.doflocs)
    ]  # like entries of the stiffness
    factors = 0.0 if multigrid else 12 * unknowns**1.33
    held = 2 if cell.remembers else 1  # the stiffness, and Newton's matrix beside it
    # measured with hexahedra of 37,000 to 553,000 unknowns: assembly, stiffness and coarse spaces
    return MeshSize(unknowns, multigrid, int(held * (140 * unknowns * row + factors)))

"""A rubber block that slides on the ground under load: its footprint and its braking force."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array, eye_array, hstack, vstack

from multiscale.convergence import Solution
from multiscale.errors import CaseError
from multiscale.fe.boxes import box_mesh
from multiscale.fe.condensation import condense_body
from multiscale.fe.elasticity import displacement_basis, stiffness_matrix
from multiscale.fe.faces import face_operator, face_unknowns
from multiscale.laws.steady_sliding import SteadySliding
from multiscale.macro.monolithic import solve_interface

__all__ = ["Footprint", "TreadBlock", "condense_tread", "slide_tread"]


@dataclass(frozen=True)
class TreadBlock:
    """An elastic block, bonded above to a rigid carcass that is pressed down and does not tilt.

    Parameters
    ----------
    size : tuple of float
        Lengths along the motion (x), across it (y) and height (z), m.
    youngs_modulus, poissons_ratio : float
        Pa, and at least 0 and below 1/2.
    elements : tuple of int
        Along x, y and z; 27 nodes each.

    Raises
    ------
    CaseError
        If a modulus is outside its range.
    """

    size: tuple[float, float, float]
    youngs_modulus: float
    poissons_ratio: float
    elements: tuple[int, int, int] = (10, 6, 3)

    def __post_init__(self) -> None:
        if not 0.0 < self.youngs_modulus < np.inf:
            raise CaseError(f"youngs_modulus must be positive (Pa), got {self.youngs_modulus:g}")
        if not 0.0 <= self.poissons_ratio < 0.5:
            raise CaseError(
                f"poissons_ratio must be at least 0 and below 0.5, got {self.poissons_ratio:g}"
            )

    @property
    def area(self) -> float:
        """Nominal contact area, m²."""
        return self.size[0] * self.size[1]


@dataclass(frozen=True, eq=False)
class CondensedTread:
    """A block condensed onto its face and the approach of the carcass.

    Attributes
    ----------
    block : TreadBlock
    stiffness : ndarray, shape (n, n)
        N/m; the last unknown is the displacement of the carcass along z.
    jump_operator : csr_array, shape (3 * points, n)
        Normal first, then along x and y; side 1 is the ground.
    weight : ndarray, shape (points,)
        m².
    position : ndarray, shape (2, points)
        x and y, from the middle of the face, m.
    """

    block: TreadBlock
    stiffness: np.ndarray
    jump_operator: csr_array
    weight: np.ndarray
    position: np.ndarray


@dataclass(frozen=True, eq=False)
class Footprint:
    """What a sliding block and the ground do to each other.

    Attributes
    ----------
    traction, jump : ndarray, shape (3, points)
        Normal, along and across the motion; Pa and m.
    weight : ndarray, shape (points,)
        m².
    solution : Solution
        Why the solver stopped.
    """

    traction: np.ndarray
    jump: np.ndarray
    weight: np.ndarray
    solution: Solution

    @property
    def load(self) -> float:
        """Normal force, N."""
        return float(-self.weight @ self.traction[0])

    @property
    def braking_force(self) -> float:
        """Force of the ground against the motion along x, N."""
        return float(self.weight @ self.traction[1])


def condense_tread(block: TreadBlock) -> CondensedTread:
    """Condense a block onto its face and the approach of its carcass."""
    from skfem import ElementHex2

    x, y, _ = block.size
    mesh = box_mesh(block.size, block.elements, origin=(-0.5 * x, -0.5 * y, 0.0))
    basis = displacement_basis(mesh, ElementHex2())
    K = stiffness_matrix(basis, block.youngs_modulus, block.poissons_ratio)
    top, face = face_unknowns(basis, "top"), face_unknowns(basis, "bottom")
    face_rows = (3 * face[:, None] + np.arange(3)).ravel()
    held = (3 * top[:, None] + np.arange(3)).ravel()
    inner = np.setdiff1d(np.arange(3 * basis.N), np.union1d(face_rows, held))

    follow = np.zeros((3 * basis.N, 1))
    follow[3 * top + 2] = 1.0
    free = eye_array(3 * basis.N, format="csr")[:, np.concatenate([inner, face_rows])]
    expand = csr_array(hstack([free, csr_array(follow)]))
    n = face_rows.size + 1
    condensed = condense_body(
        expand.T @ K @ expand, inner.size + np.arange(n), name="the stiffness of the tread block"
    )

    operator, weight, position = face_operator(basis, "bottom", order=4)
    values = csr_array(operator.tocsc()[:, face])
    pick = eye_array(n, format="csr")
    jump = [values @ pick[np.arange(face.size) * 3 + axis] for axis in (2, 0, 1)]
    jump_operator = csr_array(vstack(jump))
    return CondensedTread(block, condensed.blocks[0], jump_operator, weight, position[:2])


def slide_tread(
    tread: CondensedTread, law: SteadySliding, pressure: float, *, tolerance: float = 1e-9
) -> Footprint:
    r"""Press a block by a mean pressure and let it slide steadily.

    Parameters
    ----------
    tread : CondensedTread
    law : SteadySliding
        Of the ground, with a velocity along x and y.
    pressure : float
        Nominal, Pa.
    tolerance : float
        See :func:`~multiscale.macro.monolithic.solve_interface`.

    Raises
    ------
    CaseError
        If the pressure is not positive.

    Notes
    -----
    In the frame of the carcass the block is at rest, whatever it was on the way. With its condensed
    stiffness K, the jump B u against the ground and the force :math:`f` on the carcass

    .. math:: K u + B^T (w\, t(B u)) = f.

    Friction bends the block about the edge that leads, so that pressure moves there. Where friction
    shears the block by about a third of its height or more, there may be no steady state: the
    ``detail`` of a solution that did not converge says so.
    """
    if not 0.0 < pressure < np.inf:
        raise CaseError(f"the pressure must be positive (Pa), got {pressure:g}")
    load = np.zeros(len(tread.stiffness))
    load[-1] = -pressure * tread.block.area
    start = np.zeros(load.size)
    start[2::3] = float(law.normal.gap_at(np.array(pressure))) - law.normal.gap
    start[-1] = start[2]
    solution = solve_interface(
        tread.stiffness,
        load,
        tread.jump_operator,
        tread.weight,
        law,
        start=start,
        tolerance=tolerance,
    )
    if not solution.converged:
        solution = replace(solution, detail=_describe(tread.block, law, pressure))
    jump = (tread.jump_operator @ solution.value).reshape(3, -1)
    traction = law.respond(jump, np.empty((0, tread.weight.size))).traction
    return Footprint(traction, jump, tread.weight, solution)


def _describe(block: TreadBlock, law: SteadySliding, pressure: float) -> str:
    """Say how far the friction of an even pressure, Pa, would shear a block."""
    speed = np.array(np.linalg.norm(law.velocity))
    mu = float(law.friction.coefficient(np.array(pressure), speed))
    strain = 2.0 * (1.0 + block.poissons_ratio) * mu * pressure / block.youngs_modulus
    return (
        f"a friction coefficient of {mu:.3g} at {pressure:.3g} Pa would shear the block by "
        f"{strain:.2g} of its height and bends it over the edge that leads, where no steady "
        f"sliding was found; lower the friction or the pressure, or take stiffer rubber"
    )

r"""Boxes of voxels with displacement sides and with traction sides.

Displacement sides hold the nodes of all sides at the displacement of the mean strain. Traction
sides load the solid part S of the sides, at places where both opposite sides are solid to some
depth: thin films above pores would bend far, and the bound holds for every choice of places. With
the forces :math:`f_\tau` of a symmetric tensor :math:`\tau`, per area
:math:`\tau_{ja} / (A_a L_a)` on the sides normal to axis a, of the distance :math:`L_a` and the
solid area :math:`A_a`,

.. math:: f_\tau \cdot (\bar\varepsilon x) = \tau : \bar\varepsilon, \qquad
    \min_{f_\tau \cdot u = \tau : \bar\varepsilon\ \forall \tau} u \cdot K u
    = \bar\varepsilon : F^{-1} : \bar\varepsilon, \qquad
    F_{jk} = f_j \cdot K^+ f_k.    \tag{1}

These forces have neither resultant nor moment. A periodic displacement meets the constraint, and so
:math:`F^{-1} / V` is at most the periodic stiffness. Solid without pores at its sides has uniform
tractions.

With scalar Laplacians in place of the elasticity, whose ratio is bounded by Korn's inequality,
sine and cosine transforms invert the stiffness of a uniform box for both kinds of sides.

References
----------
.. [1] C. Huet, J. Mech. Phys. Solids 38 (1990) 813-841: both kinds of sides bound the stiffness.
.. [2] S. D. Mesarovic and J. Padbidri, Philos. Mag. 85 (2005) 65-78: constraints as weak as (1).
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy import fft, ndimage

from multiscale.convergence import Solution
from multiscale.executors import thread_count
from multiscale.laws.bulk.moduli import VOIGT
from multiscale.micro.damage.voxel_operator import VoxelOperator
from multiscale.numerics.vectors import dot

__all__ = ["HeldVoxels", "traction_stiffness"]

DEEP = 12
"""Edges of the box over the depth to which loaded places of its sides are solid, at first."""

Solve = Callable[[VoxelOperator, np.ndarray], tuple[Solution, np.ndarray]]
"""From a stiffness and nodal forces to the solution and the forces left."""


class HeldVoxels(VoxelOperator):
    """Voxels whose nodes on the sides are held; opposite sides share their nodes."""

    def __init__(
        self, lame: np.ndarray, shear: np.ndarray, spacing: Sequence[float] | np.ndarray
    ) -> None:
        super().__init__(lame, shear, spacing)
        angles = [np.pi * np.arange(1, n) / n for n in self.lame.shape]
        self._inverse = _invert_laplacians(angles, self.reference, self.edges)

    def forces(self, u: np.ndarray, strain: np.ndarray | None = None) -> np.ndarray:
        """Nodal forces, none on the sides."""
        out = super().forces(u, strain)
        out[:, 0] = out[:, :, 0] = out[:, :, :, 0] = 0.0
        return out

    def precondition(self, force: np.ndarray) -> np.ndarray:
        """Displacement of Laplacians of the mean material that vanishes on the sides."""
        inner = fft.dstn(
            force[:, 1:, 1:, 1:], type=1, axes=(1, 2, 3), norm="ortho", workers=thread_count()
        )
        inner *= self._inverse
        z = np.zeros_like(force)
        z[:, 1:, 1:, 1:] = fft.dstn(
            inner, type=1, axes=(1, 2, 3), norm="ortho", workers=thread_count(), overwrite_x=True
        )
        return z


class FreeVoxels(VoxelOperator):
    """Voxels with free sides, the last of which along every axis are void."""

    def __init__(
        self, lame: np.ndarray, shear: np.ndarray, spacing: Sequence[float] | np.ndarray
    ) -> None:
        super().__init__(lame, shear, spacing)
        angles = [np.pi * np.arange(n) / (n - 1) for n in self.lame.shape]
        self._inverse = _invert_laplacians(angles, self.reference, self.edges)
        self._share = np.ones(self.lame.shape, dtype=np.float32)  # of the volume at a node
        for axis in range(3):
            ends = np.moveaxis(self._share, axis, 0)
            ends[[0, -1]] *= np.sqrt(2.0)  # one over the root of one half

    def precondition(self, force: np.ndarray) -> np.ndarray:
        """Displacement of Laplacians of the mean material with free sides, without mean."""
        z = fft.dctn(
            self._share * force, type=1, axes=(1, 2, 3), norm="ortho", workers=thread_count()
        )
        z *= self._inverse
        return np.asarray(
            self._share
            * fft.dctn(
                z, type=1, axes=(1, 2, 3), norm="ortho", workers=thread_count(), overwrite_x=True
            )
        )


def traction_stiffness(
    modulus: np.ndarray, lame: float, shear: float, edges: np.ndarray, solve: Solve
) -> tuple[np.ndarray, list[Solution]]:
    """Stiffness (1) of voxels with traction sides, and the solution of each load."""
    pieces, count = ndimage.label(modulus > 0.0)
    if count > 1:  # pieces apart move freely
        largest = np.argmax(np.bincount(pieces.ravel())[1:]) + 1
        modulus = np.where(pieces == largest, modulus, 0.0)
    n = np.array(modulus.shape)
    padded = np.pad(modulus, ((0, 1),) * 3)
    operator = FreeVoxels(lame * padded, shear * padded, edges)
    loads = np.zeros((6, 3, *padded.shape))
    carried = np.ones(6, dtype=bool)
    for axis in range(3):
        both = np.pad(_loaded(np.moveaxis(modulus > 0.0, axis, 0)).astype(float), 1)
        at_nodes = both[1:, 1:] + both[:-1, 1:] + both[1:, :-1] + both[:-1, :-1]
        total = at_nodes.sum()
        for k, (i, j) in enumerate(VOIGT):
            if axis not in (i, j):
                continue
            if total == 0.0:  # nothing crosses the box along the axis
                carried[k] = False
                continue
            along = np.moveaxis(loads[k, j if axis == i else i], axis, 0)
            share = at_nodes / (total * n[axis] * edges[axis])
            along[-1] += share
            along[0] -= share
    solved: list[Solution] = []
    F = np.zeros((6, 6))
    for k in range(6):
        one, r = solve(operator, loads[k] * carried[k])
        solved.append(replace(one, value=one.value.astype(np.float32)))
        for j in range(k + 1):
            u = solved[j].value
            F[j, k] = F[k, j] = dot(loads[j], one.value) + dot(u, r)
    stiffness = np.zeros((6, 6))
    kept = np.ix_(carried, carried)
    stiffness[kept] = np.linalg.inv(F[kept]) / (np.prod(edges) * modulus.size)  # (1)
    return stiffness, [replace(one, value=F[k]) for k, one in enumerate(solved)]


def _loaded(solid: np.ndarray) -> np.ndarray:
    """Places of the first and the last layer that are loaded, as deep in the solid as there are."""
    depth = max(1, len(solid) // DEEP)
    while True:
        deep = np.asarray(solid[:depth].all(axis=0) & solid[-depth:].all(axis=0))
        if depth == 1 or deep.any():
            return deep
        depth //= 2


def _invert_laplacians(
    angles: list[np.ndarray], reference: tuple[float, float], edges: np.ndarray
) -> np.ndarray:
    """Inverse of the diagonal blocks of the stiffness for products of sines or cosines."""
    lame, shear = reference
    sine = [np.sin(0.5 * t) ** 2 for t in angles]
    parts = []
    for axis in range(3):
        factors = [
            s / edges[k] ** 2 if k == axis else 1.0 - 2.0 * s / 3.0 for k, s in enumerate(sine)
        ]
        parts.append(np.einsum("i,j,k->ijk", *factors))
    total = shear * sum(parts)
    blocks = 4.0 * np.prod(edges) * np.stack([total + (lame + shear) * one for one in parts])
    blocks[blocks == 0.0] = np.inf  # a motion of the whole
    return np.asarray(1.0 / blocks, dtype=np.float32)

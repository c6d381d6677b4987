r"""Compatibility operator :math:`e = B u` of nodes and links."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from multiscale.laws.link import Beam
from multiscale.macro.discrete.link_system import LinkSystem
from multiscale.numerics.compiled import compiled

__all__ = ["LinkEquations", "compatibility", "elongations", "equations", "nodal_forces"]


@dataclass(frozen=True, eq=False)
class LinkEquations:
    r"""Arrays of the equilibrium :math:`B^T \tau(B u) = \alpha F^d`.

    The rows are the elongations of the links in their order, then the other modes of the beams.
    Rotations are multiplied by a length and moments divided by it, so that every unknown is in m
    and every force in N.

    Attributes
    ----------
    link : ndarray of int, shape (rows,), link of a row
    unknown : ndarray of int, shape (rows, w), unknowns of a row, -1 for fixed components
    coefficient : ndarray, shape (rows, w), entries of :math:`B`
    stiffness, prestress, lower, upper : ndarray, shape (rows,)
        :math:`k` (N/m), :math:`\tau^0` and the admissible range (N).
    load : ndarray, shape (n,), :math:`F^d`, N
    number : ndarray of int, shape (nodes, c)
        Unknown of each component of the nodes, -1 for fixed components.
    unit : ndarray, shape (c,)
        Factor of each component: 1 for displacements, a length, m, for rotations.
    """

    link: np.ndarray
    unknown: np.ndarray
    coefficient: np.ndarray
    stiffness: np.ndarray
    prestress: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    load: np.ndarray
    number: np.ndarray
    unit: np.ndarray

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.load.size

    @cached_property
    def operator(self) -> csr_array:
        """Sparse B, shape (rows, n)."""
        row = np.repeat(np.arange(len(self.unknown)), self.unknown.shape[1])
        column, value = self.unknown.ravel(), self.coefficient.ravel()
        held = (column < 0) | (value == 0.0)
        shape = (len(self.unknown), self.n)
        return csr_array((value[~held], (row[~held], column[~held])), shape=shape)

    @property
    def finite_stiffness(self) -> np.ndarray:
        """Stiffness of the rows, N/m; links of fixed length have the largest finite stiffness."""
        rigid = np.isinf(self.stiffness)
        stiffest = float(np.max(self.stiffness[~rigid], initial=0.0)) or 1.0
        return np.where(rigid, stiffest, self.stiffness)

    def at_nodes(self, u: np.ndarray) -> np.ndarray:
        """Return unknowns at the nodes, shape (nodes, c), m and rad; zero for fixed components."""
        # -1 selects the appended zero
        return np.asarray(np.append(u, 0.0)[self.number] / self.unit)

    def elongate(self, u: np.ndarray) -> np.ndarray:
        """Return B u, shape (rows,), m."""
        return np.asarray(elongations(self.unknown, self.coefficient, u))

    def gather(self, tension: np.ndarray) -> np.ndarray:
        """Return B^T tau, shape (n,), N."""
        return np.asarray(nodal_forces(self.unknown, self.coefficient, tension, self.n))


def equations(system: LinkSystem) -> LinkEquations:
    """Return one row per deformation of the links, and the numbers of the unknowns."""
    c = system.n_components
    free = ~np.asarray(system.fixed, dtype=bool)
    number = np.full(free.shape, -1, dtype=np.int32)
    number[free] = np.arange(np.count_nonzero(free), dtype=np.int32)
    unit = np.ones(c)
    unit[3:] = system.length.mean()

    coefficient = np.zeros((system.n_links, 2, c))
    coefficient[:, 0, :3], coefficient[:, 1, :3] = -system.direction, system.direction
    rows = np.arange(system.n_links)
    stiffness, (lower, upper) = system.stiffness, system.bounds
    if c == 6:
        beam_rows, beam_coefficient, beam_stiffness = _beam_modes(system)
        rows = np.concatenate([rows, beam_rows])
        coefficient = np.concatenate([coefficient, beam_coefficient])
        stiffness = np.concatenate([stiffness, beam_stiffness])
    extra = rows.size - system.n_links
    return LinkEquations(
        link=rows,
        unknown=np.ascontiguousarray(number[system.ends[rows]].reshape(rows.size, -1)),
        coefficient=(coefficient / unit).reshape(rows.size, -1),
        stiffness=stiffness,
        prestress=np.append(system.prestress, np.zeros(extra)),
        lower=np.append(lower, np.full(extra, -np.inf)),
        upper=np.append(upper, np.full(extra, np.inf)),
        load=(system.load / unit)[free],
        number=number,
        unit=unit,
    )


def _beam_modes(system: LinkSystem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return links, coefficients (rows, 2, 6) and stiffness of five modes of each beam."""
    rows, coefficients, stiffness = [], [], []
    for index, law in enumerate(system.laws):
        if not isinstance(law, Beam):
            continue
        links = np.flatnonzero(system.kind == index)
        x, y, z = beam_axes(system.direction[links], np.array(law.up, dtype=float))
        chord = 2.0 / system.length[links, None]
        modes = np.zeros((5, links.size, 2, 6))
        modes[0, :, 0, 3:], modes[0, :, 1, 3:] = -x, x
        for first, axis, across in ((1, y, z), (3, z, -y)):
            modes[first, :, 0, 3:], modes[first, :, 1, 3:] = axis, -axis
            modes[first + 1, :, 0, 3:], modes[first + 1, :, 1, 3:] = axis, axis
            modes[first + 1, :, 0, :3], modes[first + 1, :, 1, :3] = -chord * across, chord * across
        rows.append(np.repeat(links, 5))
        coefficients.append(modes.transpose(1, 0, 2, 3).reshape(-1, 2, 6))
        stiffness.append(law.mode_stiffness(system.length[links])[1:].T.ravel())
    return np.concatenate(rows), np.concatenate(coefficients), np.concatenate(stiffness)


def beam_axes(direction: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the local axes x, y, z of beams, each of shape (beams, 3)."""
    up = up / np.sqrt(up @ up)
    along = np.abs(direction @ up) > 1.0 - 1e-9
    upward = np.where(along[:, None], np.array([1.0, 0.0, 0.0]), up)
    z = upward - np.einsum("bi,bi->b", upward, direction)[:, None] * direction
    z = z / np.sqrt(np.einsum("bi,bi->b", z, z))[:, None]
    return direction, np.cross(z, direction), z


def compatibility(system: LinkSystem) -> csr_array:
    r"""Return the sparse compatibility operator of the free unknowns."""
    return equations(system).operator


@compiled
def elongations(unknown: np.ndarray, coefficient: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return B u, shape (rows,)."""
    e = np.empty(unknown.shape[0])
    for row in range(unknown.shape[0]):
        total = 0.0
        for p in range(unknown.shape[1]):
            if unknown[row, p] >= 0:
                total += coefficient[row, p] * u[unknown[row, p]]
        e[row] = total
    return e


@compiled
def nodal_forces(
    unknown: np.ndarray, coefficient: np.ndarray, tension: np.ndarray, n: int
) -> np.ndarray:
    """Return B^T tau, shape (n,)."""
    force = np.zeros(n)
    for row in range(unknown.shape[0]):
        for p in range(unknown.shape[1]):
            if unknown[row, p] >= 0:
                force[unknown[row, p]] += coefficient[row, p] * tension[row]
    return force

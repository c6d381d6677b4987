r"""Preconditioner of a cut structure by balanced solves of its substructures (BDDC) [1]_.

With the Schur complements :math:`S_1`, :math:`S_2` of both sides on an edge and the flexibility
:math:`F`, the sum of both sides with tied corners, the balanced motions are :math:`L z` for every
large :math:`\nu` [2]_ of

.. math::
    H = S_1 (S_1 + S_2)^{-1} S_2 = L L^T, \qquad L^T F L z = \nu z.    \tag{1}

.. [1] C. R. Dohrmann, SIAM J. Sci. Comput. 25 (2003) 246-258, doi:10.1137/S1064827502412887.
.. [2] J. Mandel, B. Sousedík, Comput. Methods Appl. Mech. Eng. 196 (2007) 1389-1399,
   doi:10.1016/j.cma.2006.03.010.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.linalg import cholesky, eigh, norm, qr, solve
from scipy.sparse import coo_array, csr_array

from multiscale.fe.elasticity import Split
from multiscale.macro.substructures.coarse import interface_motions
from multiscale.macro.substructures.stack import Stack, together
from multiscale.numerics.factorisation import Solve

FLEXIBLE = 10.0
"""Eigenvalue of (1) above which the coarse problem balances a motion."""

REGULAR = 1e-12
"""Share of its mean eigenvalue that is added to H of (1)."""


@dataclass(frozen=True, eq=False)
class Face:
    """Perfect interface; its unknowns in the Schur complements of this process's substructures."""

    number: int
    sides: tuple[int, ...]
    averages: np.ndarray  # orthonormal motions, (size, motions)
    at: dict[int, np.ndarray]  # its columns, by the substructure, counted in this process
    tied: dict[int, np.ndarray]  # its columns, then the corners that its two sides share
    corners: int  # number of their unknowns

    @property
    def adapts(self) -> bool:
        """Whether (1) chooses the motions: not for a corner, nor without corners."""
        size, motions = self.averages.shape
        return len(self.sides) == 2 and self.corners > 0 and size > motions


@dataclass(frozen=True, eq=False)
class Layout:
    """Shared unknowns of the substructures of a process; rows are filled up by ``n_shared``."""

    shared: np.ndarray  # (substructures, w)
    n_shared: int
    stack: Stack
    faces: Sequence[Face]

    def take(self, value: np.ndarray) -> np.ndarray:
        """Restrict shared unknowns to every substructure, shape (substructures, w, 1)."""
        return np.asarray(np.append(value, 0.0)[self.shared][:, :, None])

    def add(self, value: np.ndarray) -> np.ndarray:
        """Add up over the substructures of all processes, shape (shared,)."""
        force = np.bincount(self.shared.ravel(), value.ravel(), self.n_shared + 1)
        return self.stack.team.total(force[:-1])


def lay_out(split: Split, slot: np.ndarray, stack: Stack) -> Layout:
    """Tabulate the shared unknowns of the substructures of this process."""
    count, local = split.edge_start.size - 1, stack.local
    interfaces = stack.problem.interfaces
    first = np.cumsum([0, *(face.size for face in interfaces)])
    shared = np.full((count, int(np.diff(split.edge_start).max(initial=0))), first[-1])
    shared[split.owner, split.column] = slot
    corners: dict[tuple[int, ...], list[np.ndarray]] = {}
    for number, face in enumerate(interfaces):
        if len(face.sides) > 2:
            for pair in combinations(face.sides, 2):
                corners.setdefault(pair, []).append(np.arange(first[number], first[number + 1]))

    order, faces = np.argsort(shared, axis=1), []
    for number, face in enumerate(interfaces):
        mine = np.arange(first[number], first[number + 1])
        both = np.concatenate([mine, *corners.get(face.sides, [])])
        tied = {
            row: order[row][np.searchsorted(shared[row], both, sorter=order[row])]
            for row in (owner - local.start for owner in face.sides if owner in local)
        }
        at = {owner: columns[: face.size] for owner, columns in tied.items()}
        averages = interface_motions(face, stack.problem)
        faces.append(Face(number, face.sides, averages, at, tied, both.size - face.size))
    return Layout(shared, int(first[-1]), stack, faces)


class Balancing:
    r"""Preconditioner, renewed where the Schur complements of substructures change.

    With the balanced motions :math:`C_E` and the symmetric part :math:`S_E` of the Schur
    complement, to which ``added`` is added on the diagonal,

    .. math::
        M^{-1} = \sum_E R_E^T D_E (Z_E + \Phi_E L^{-1} \Psi_E^T) D_E^T R_E,    \tag{2}

    .. math::
        \begin{pmatrix} S_E & C_E^T \\ C_E & 0 \end{pmatrix}^{-1} =
        \begin{pmatrix} Z_E & \Phi_E \\ \Psi_E^T & -L_E \end{pmatrix}, \qquad
        L = \sum_E L_E, \qquad
        D_E^{FF} = \Big( \sum_{E'} S_{E'}^{FF} \Big)^{-1} S_E^{FF}.    \tag{3}
    """

    def __init__(self, layout: Layout, added: np.ndarray) -> None:
        self.layout, self.added = layout, added
        count, width = layout.shared.shape
        self.schur, self.fine, self.scaling = np.zeros((3, count, width, width))
        # of every substructure: S + added, its inverse, and D Phi, Psi^T D^T, L
        nothing = np.zeros((0, 0))
        self.supported, self.flexibility = [nothing] * count, [nothing] * count
        self.coarse_parts = [(nothing, nothing, nothing)] * count
        self.motions = [face.averages for face in layout.faces]  # C^T of every interface
        self.faces_of: list[list[tuple[int, np.ndarray]]] = [[] for _ in range(count)]
        for face in layout.faces:
            for owner, at in face.at.items():
                self.faces_of[owner].append((face.number, at))
        self.n_coarse = 0
        self.solve: Solve = np.zeros_like

    def renew(self, blocks: dict[int, np.ndarray], factorise: Callable[[csr_array], Solve]) -> None:
        """Replace the Schur complements, N/m, of some substructures of this process."""
        team = self.layout.stack.team
        together(team, lambda: self._support(blocks))
        # interfaces next to them: stiffness of the sides, balanced motions, shares of the sides
        chosen = np.zeros(len(self.supported))
        chosen[list(blocks)] = 1.0
        changed = team.concatenate(chosen) > 0.0
        stale = [face for face in self.layout.faces if changed[list(face.sides)].any()]
        sums = self._sum_sides(stale)
        together(team, lambda: self._balance(stale, sums))
        # substructures at these interfaces
        touched = set(blocks).union(*(face.at for face in stale))
        together(team, lambda: self._invert(touched))
        self._assemble(factorise)

    def _support(self, blocks: dict[int, np.ndarray]) -> None:
        """Evaluate the supported Schur complements and their inverses."""
        for owner, S in blocks.items():
            n = len(S)
            self.schur[owner, :n, :n] = S
            H = 0.5 * (S + S.T) + np.diag(self.added[owner, :n])
            self.supported[owner], self.flexibility[owner] = H, scaled_inverse(H)

    def _sum_sides(self, faces: Sequence[Face]) -> np.ndarray:
        """Stiffness of the sides, and flexibility of the jump, of all processes, in turn."""
        parts, first = [np.zeros(0)], self.layout.stack.local.start
        for face in faces:
            size = len(face.averages)
            stiffness = np.zeros((2 if face.adapts else 1, size, size))
            flexibility = np.zeros((size + face.corners,) * 2)
            for owner, at in face.at.items():
                side = face.sides.index(owner + first) if face.adapts else 0
                stiffness[side] += self.supported[owner][np.ix_(at, at)]
                tied = face.tied[owner]
                flexibility += self.flexibility[owner][np.ix_(tied, tied)]
            parts += [stiffness.ravel(), flexibility.ravel()][: 1 + face.adapts]
        return self.layout.stack.team.total(np.concatenate(parts))

    def _balance(self, faces: Sequence[Face], sums: np.ndarray) -> None:
        """Choose the balanced motions of interfaces, and share their motions out by (3)."""
        for face in faces:
            size, wide = len(face.averages), len(face.averages) + face.corners
            count = (2 if face.adapts else 1) * size**2
            stiffness, sums = sums[:count].reshape(-1, size, size), sums[count:]
            if face.adapts:
                flexibility, sums = sums[: wide**2].reshape(wide, wide), sums[wide**2 :]
            if not face.at:
                continue
            if face.adapts:
                try:
                    motions = flexible_motions(stiffness[0], stiffness[1], flexibility)
                except np.linalg.LinAlgError:  # a law that softens
                    motions = face.averages
                self.motions[face.number] = motions
            total = stiffness.sum(axis=0)
            for owner, at in face.at.items():
                here = np.ix_(at, at)
                self.scaling[owner][here] = solve(total, self.supported[owner][here])

    def _invert(self, owners: Iterable[int]) -> None:
        """Evaluate (3) for substructures; their stiffness is scaled by the largest entry."""
        for owner in owners:
            n = len(self.supported[owner])
            motions = (np.eye(n)[:, at] @ self.motions[face] for face, at in self.faces_of[owner])
            C = np.hstack([np.zeros((n, 0)), *motions])
            S = self.schur[owner, :n, :n] + np.diag(self.added[owner, :n])
            unit = float(S.diagonal().max(initial=0.0)) or 1.0
            saddle = np.block([[S / unit, C], [C.T, np.zeros((C.shape[1],) * 2)]])
            inverse, D = np.linalg.inv(saddle), self.scaling[owner, :n, :n]
            self.fine[owner, :n, :n] = D @ (inverse[:n, :n] / unit) @ D.T
            coarse = D @ inverse[:n, n:], inverse[n:, :n] @ D.T, -unit * inverse[n:, n:]
            self.coarse_parts[owner] = coarse

    def _assemble(self, factorise: Callable[[csr_array], Solve]) -> None:
        """Collect (3) in tables, and factorise the coarse matrix on the first process."""
        team, layout = self.layout.stack.team, self.layout
        counts = np.zeros(len(layout.faces))
        for face in layout.faces:
            if face.sides[0] in layout.stack.local:
                counts[face.number] = self.motions[face.number].shape[1]
        start = np.append(0, np.cumsum(team.total(counts))).astype(int)
        self.n_coarse = int(start[-1])
        numbers = [
            np.concatenate(
                [np.zeros(0, int), *(np.arange(start[k], start[k + 1]) for k, _ in faces)]
            )
            for faces in self.faces_of
        ]
        # tables, filled up by the number of all motions
        (p, w), width = layout.shared.shape, max((item.size for item in numbers), default=0)
        self.coarse = np.full((p, width), self.n_coarse)
        self.right, self.left = np.zeros((p, w, width)), np.zeros((p, width, w))
        entries = []
        for owner, (number, parts) in enumerate(zip(numbers, self.coarse_parts, strict=True)):
            right, left, stiffness = parts
            m, n = number.size, len(right)
            self.coarse[owner, :m] = number
            self.right[owner, :n, :m], self.left[owner, :m, :n] = right, left
            entries.append((stiffness.ravel(), np.repeat(number, m), np.tile(number, m)))
        if not self.n_coarse:
            return
        value, row, column = (
            np.concatenate(item) for item in zip(*team.collect(entries), strict=True)
        )
        matrix = csr_array(coo_array((value, (row, column)), shape=(self.n_coarse,) * 2))
        # a single process solves, so that all have the same digits
        factors = together(team, lambda: None if team.rank else factorise(matrix))
        self.solve = lambda right: team.total(
            np.zeros_like(right) if factors is None else factors(right)
        )

    def multiply(self, value: np.ndarray) -> np.ndarray:
        """Apply the sum of the Schur complements, shape (shared,)."""
        return self.layout.add(self.schur @ self.layout.take(value))

    def __call__(self, force: np.ndarray) -> np.ndarray:
        """Approximate displacement of the shared unknowns for a force on them, (2)."""
        layout = self.layout
        shares = layout.take(force)
        u = self.fine @ shares
        if self.n_coarse:
            amount = (self.left @ shares)[:, :, 0]
            total = np.bincount(self.coarse.ravel(), amount.ravel(), self.n_coarse + 1)[:-1]
            w = np.append(self.solve(layout.stack.team.total(total)), 0.0)
            u += self.right @ w[self.coarse][:, :, None]
        return layout.add(u)


def flexible_motions(first: np.ndarray, second: np.ndarray, flexibility: np.ndarray) -> np.ndarray:
    """Orthonormal motions of (1) from the stiffness of both sides, and the flexibility."""
    size = len(first)
    H = first @ solve(first + second, second)
    H = 0.5 * (H + H.T) + REGULAR * np.trace(H) / size * np.eye(size)
    tied, across = flexibility[:size, :size], flexibility[:size, size:]
    F = tied - across @ solve(flexibility[size:, size:], across.T)
    L = cholesky(H)
    M = L.T @ F @ L
    nu, Z = eigh(0.5 * (M + M.T))
    motions = L @ Z[:, nu > FLEXIBLE]
    return np.asarray(qr(motions / norm(motions, axis=0))[0])


def scaled_inverse(matrix: np.ndarray) -> np.ndarray:
    """Invert a symmetric matrix, scaled by its diagonal."""
    scale = 1.0 / np.sqrt(matrix.diagonal())
    inverse = np.linalg.inv(matrix * scale[:, None] * scale) * scale[:, None] * scale
    return np.asarray(0.5 * (inverse + inverse.T))

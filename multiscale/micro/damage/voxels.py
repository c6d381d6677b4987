r"""Matrix-free stiffness of a box of voxels with periodic, displacement or traction sides.

Displacements, m, and nodal forces, N, have the shape ``(3, nx, ny, nz)``. A uniform material has,
with :math:`s = \sin(\theta/2)`, :math:`c = \cos(\theta/2)` and :math:`m = c^2 + s^2/3` of the phase
angles, and the edges h and volume V of a brick, the stiffness in Fourier space

.. math::
    \hat K_{xx} &= 4V \Big[ (\lambda + 2\mu) \frac{s_x^2 m_y m_z}{h_x^2}
        + \mu \frac{s_y^2 m_x m_z}{h_y^2} + \mu \frac{s_z^2 m_x m_y}{h_z^2} \Big], \\
    \hat K_{xy} &= 4V (\lambda + \mu) \frac{s_x c_x\, s_y c_y\, m_z}{h_x h_y}.    \tag{1}

Displacement sides bound the stiffness from above, traction sides from below [1]_. With the forces
:math:`f_\tau` of a symmetric tensor :math:`\tau`, per area :math:`\tau_{ja} / (A_a L_a)` on the
solid area :math:`A_a` of the sides normal to axis a at the distance :math:`L_a`, constraints as
weak as in [2]_ give

.. math:: f_\tau \cdot (\bar\varepsilon x) = \tau : \bar\varepsilon, \qquad
    \min_{f_\tau \cdot u = \tau : \bar\varepsilon\ \forall \tau} u \cdot K u
    = \bar\varepsilon : F^{-1} : \bar\varepsilon, \qquad
    F_{jk} = f_j \cdot K^+ f_k.    \tag{2}

.. [1] C. Huet, J. Mech. Phys. Solids 38 (1990) 813-841.
.. [2] S. D. Mesarovic and J. Padbidri, Philos. Mag. 85 (2005) 65-78.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy import fft, ndimage

from multiscale.convergence import Solution
from multiscale.executors import run_ranges, thread_count
from multiscale.laws.bulk.bulk_law import VOIGT
from multiscale.numerics.compiled import compiled
from multiscale.numerics.vectors import dot

LEAST = 10_000  # fewest bricks for a thread
DEEP = 12  # edge of the box over the depth to which loaded places are solid, as a first choice

Solve = Callable[["VoxelOperator", np.ndarray], tuple[Solution, np.ndarray]]
"""From a stiffness and nodal forces to the solution and the residual forces."""


class VoxelOperator:
    """Stiffness of a periodic box of bricks with Lame's parameters, Pa, and edges, m."""

    def __init__(
        self, lame: np.ndarray, shear: np.ndarray, spacing: Sequence[float] | np.ndarray
    ) -> None:
        self.lame = np.ascontiguousarray(lame, dtype=float)
        self.shear = np.ascontiguousarray(shear, dtype=float)
        self.edges = np.array(spacing, dtype=float)
        solid = self.shear > 0.0
        self.reference = (float(self.lame[solid].mean()), float(self.shear[solid].mean()))
        self._tables = [
            np.stack([np.sin(0.5 * t), np.cos(0.5 * t)])
            for t in (2.0 * np.pi * fft.fftfreq(n) for n in self.lame.shape)
        ]

    @property
    def _least(self) -> int:
        return -(-LEAST // int(self.lame[0].size))

    def forces(self, u: np.ndarray, strain: np.ndarray | None = None) -> np.ndarray:
        """Nodal forces of a periodic displacement and, if given, a mean strain, shape (6,)."""
        mean = np.zeros(6) if strain is None else np.asarray(strain, dtype=float)
        out = np.zeros_like(u)
        arguments, nx = (u, mean, self.lame, self.shear, self.edges, out), len(self.lame)
        for colour, strips in enumerate((nx // 2, nx // 2, nx % 2)):
            run_ranges(_forces, strips, colour, *arguments, least=self._least)
        return out

    def mean_stress(self, u: np.ndarray, strain: np.ndarray) -> np.ndarray:
        """Mean stress, shape (6,), Pa, of a periodic displacement and a mean strain."""
        total = np.zeros((len(u[0]), 6))
        arguments = u, np.asarray(strain, dtype=float), self.lame, self.shear, self.edges, total
        run_ranges(_stress, len(total), *arguments, least=self._least)
        return np.asarray(total.sum(axis=0) / self.lame.size)

    def precondition(self, force: np.ndarray) -> np.ndarray:
        """Displacement, with zero mean, of the same box filled with the mean material."""
        threads = thread_count()
        values = fft.rfftn(force, axes=(1, 2, 3), workers=threads)
        along_x, along_y, along_z = self._tables
        lame, shear = self.reference
        arguments = values, along_x, along_y, along_z, lame, shear, self.edges
        run_ranges(_invert, values.shape[1], *arguments, least=self._least)
        return np.asarray(
            fft.irfftn(values, s=force.shape[1:], axes=(1, 2, 3), workers=threads, overwrite_x=True)
        )

    def _invert_laplacians(self, angles: list[np.ndarray]) -> np.ndarray:
        """Inverse of the diagonal blocks of the stiffness for products of sines or cosines."""
        (lame, shear), edges = self.reference, self.edges
        sine = [np.sin(0.5 * t) ** 2 for t in angles]
        laplacians = []
        for axis in range(3):
            factors = [
                s / edges[k] ** 2 if k == axis else 1.0 - 2.0 * s / 3.0 for k, s in enumerate(sine)
            ]
            laplacians.append(np.einsum("i,j,k->ijk", *factors))
        total = shear * sum(laplacians)
        blocks = np.stack([total + (lame + shear) * along for along in laplacians])
        blocks *= 4.0 * np.prod(edges)
        blocks[blocks == 0.0] = np.inf  # translation
        return np.asarray(1.0 / blocks, dtype=np.float32)


class FixedVoxels(VoxelOperator):
    """Voxels with fixed nodes on the sides; opposite sides share their nodes."""

    @cached_property
    def _inverse(self) -> np.ndarray:
        return self._invert_laplacians([np.pi * np.arange(1, n) / n for n in self.lame.shape])

    def forces(self, u: np.ndarray, strain: np.ndarray | None = None) -> np.ndarray:
        """Nodal forces, zero on the sides."""
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
    """Voxels with free sides; the last layer along every axis is void."""

    @cached_property
    def _inverse(self) -> np.ndarray:
        return self._invert_laplacians([np.pi * np.arange(n) / (n - 1) for n in self.lame.shape])

    @cached_property
    def _share(self) -> np.ndarray:
        """Inverse square root of the share of a voxel's volume at each node."""
        share = np.ones(self.lame.shape, dtype=np.float32)
        for axis in range(3):
            np.moveaxis(share, axis, 0)[[0, -1]] *= np.sqrt(2.0)
        return share

    def precondition(self, force: np.ndarray) -> np.ndarray:
        """Displacement of Laplacians of the mean material with free sides."""
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
    """Stiffness (2) of voxels with traction sides, and the solution of each load."""
    # only the largest connected solid carries the load
    solids, count = ndimage.label(modulus > 0.0)
    if count > 1:
        largest = np.argmax(np.bincount(solids.ravel())[1:]) + 1
        modulus = np.where(solids == largest, modulus, 0.0)
    # forces f_k on the sides
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
            if total == 0.0:  # no solid connects both sides along the axis
                carried[k] = False
                continue
            along = np.moveaxis(loads[k, j if axis == i else i], axis, 0)
            share = at_nodes / (total * n[axis] * edges[axis])
            along[-1] += share
            along[0] -= share
    # flexibility F, and its inverse
    solved: list[Solution] = []
    F = np.zeros((6, 6))
    for k in range(6):
        solution, r = solve(operator, loads[k] * carried[k])
        solved.append(replace(solution, value=solution.value.astype(np.float32)))
        for j in range(k + 1):
            u = solved[j].value
            F[j, k] = F[k, j] = dot(loads[j], solution.value) + dot(u, r)
    stiffness = np.zeros((6, 6))
    loaded = np.ix_(carried, carried)
    stiffness[loaded] = np.linalg.inv(F[loaded]) / (np.prod(edges) * modulus.size)  # (2)
    return stiffness, [replace(solution, value=F[k]) for k, solution in enumerate(solved)]


def _loaded(solid: np.ndarray) -> np.ndarray:
    """Select loaded places of the first and last layer: solid to the largest depth possible."""
    depth = max(1, len(solid) // DEEP)
    while True:
        deep = np.asarray(solid[:depth].all(axis=0) & solid[-depth:].all(axis=0))
        if depth == 1 or deep.any():
            return deep
        depth //= 2


@compiled(fastmath=True)
def _rows(u, i, i1, j, j1, rows):  # type: ignore[no-untyped-def]
    """Transform the four rows of nodes along a row of bricks: rows[4 c + 2 i + j]."""
    nz = u.shape[3]
    for c in range(3):
        p, q, r, s = u[c, i, j], u[c, i1, j], u[c, i, j1], u[c, i1, j1]
        a, b, d, e = rows[4 * c], rows[4 * c + 1], rows[4 * c + 2], rows[4 * c + 3]
        for k in range(nz):
            low, high = p[k] + q[k], r[k] + s[k]
            a[k], b[k] = low + high, high - low
            low, high = q[k] - p[k], s[k] - r[k]
            d[k], e[k] = low + high, high - low
    for v in range(12):
        rows[v, nz] = rows[v, 0]


@compiled(fastmath=True)
def _row_forces(rows, mean, lame, shear, scale, volume, near, far):  # type: ignore[no-untyped-def]
    """Compute forces on the amplitudes of the node rows below and above a row of bricks."""
    x, y, z = scale
    third = 1.0 / 3.0
    for k in range(len(lame)):
        lam, mu = volume * lame[k], volume * shear[k]
        # u_ijk: sums (k = 0) and differences (k = 1) along z; i, j from the transform of the rows
        u100, u101 = rows[2, k] + rows[2, k + 1], rows[2, k + 1] - rows[2, k]
        u010, u011 = rows[1, k] + rows[1, k + 1], rows[1, k + 1] - rows[1, k]
        u110, u111 = rows[3, k] + rows[3, k + 1], rows[3, k + 1] - rows[3, k]
        u001 = rows[0, k + 1] - rows[0, k]
        v100, v101 = rows[6, k] + rows[6, k + 1], rows[6, k + 1] - rows[6, k]
        v010, v011 = rows[5, k] + rows[5, k + 1], rows[5, k + 1] - rows[5, k]
        v110, v111 = rows[7, k] + rows[7, k + 1], rows[7, k + 1] - rows[7, k]
        v001 = rows[4, k + 1] - rows[4, k]
        w100, w101 = rows[10, k] + rows[10, k + 1], rows[10, k + 1] - rows[10, k]
        w010, w011 = rows[9, k] + rows[9, k + 1], rows[9, k + 1] - rows[9, k]
        w110, w111 = rows[11, k] + rows[11, k + 1], rows[11, k + 1] - rows[11, k]
        w001 = rows[8, k + 1] - rows[8, k]

        # constant strains
        xx, yy, zz = x * u100 + mean[0], y * v010 + mean[1], z * w001 + mean[2]
        pressure = lam * (xx + yy + zz)
        sxx, syy, szz = pressure + 2.0 * mu * xx, pressure + 2.0 * mu * yy, pressure + 2.0 * mu * zz
        syz = mu * (z * v001 + y * w010 + mean[3])
        sxz = mu * (z * u001 + x * w100 + mean[4])
        sxy = mu * (y * u010 + x * v100 + mean[5])
        f100, f010, f001 = x * sxx, y * sxy, z * sxz
        g100, g010, g001 = x * sxy, y * syy, z * syz
        h100, h010, h001 = x * sxz, y * syz, z * szz

        # strains linear in x, in y and in z
        lam, mu = third * lam, third * mu
        yy, zz = y * v110, z * w101
        pressure = lam * (yy + zz)
        syz = mu * (z * v101 + y * w110)
        g110, h101 = y * (pressure + 2.0 * mu * yy), z * (pressure + 2.0 * mu * zz)
        g101, h110 = z * syz, y * syz
        f110, f101 = y * mu * y * u110, z * mu * z * u101
        xx, zz = x * u110, z * w011
        pressure = lam * (xx + zz)
        sxz = mu * (z * u011 + x * w110)
        f110 += x * (pressure + 2.0 * mu * xx)
        h011 = z * (pressure + 2.0 * mu * zz)
        f011 = z * sxz
        h110 += x * sxz
        g110 += x * mu * x * v110
        g011 = z * mu * z * v011
        xx, yy = x * u101, y * v011
        pressure = lam * (xx + yy)
        sxy = mu * (y * u011 + x * v101)
        f101 += x * (pressure + 2.0 * mu * xx)
        g011 += y * (pressure + 2.0 * mu * yy)
        f011 += y * sxy
        g101 += x * sxy
        h101 += x * mu * x * w101
        h011 += y * mu * y * w011

        # strains bilinear in two coordinates
        lam, mu = third * lam, third * mu
        stiff = lam + 2.0 * mu
        f111 = (stiff * x * x + mu * (y * y + z * z)) * u111
        g111 = (stiff * y * y + mu * (x * x + z * z)) * v111
        h111 = (stiff * z * z + mu * (x * x + y * y)) * w111

        near[0, k], far[0, k] = -f001, f001
        near[1, k], far[1, k] = f010 - f011, f010 + f011
        near[2, k], far[2, k] = f100 - f101, f100 + f101
        near[3, k], far[3, k] = f110 - f111, f110 + f111
        near[4, k], far[4, k] = -g001, g001
        near[5, k], far[5, k] = g010 - g011, g010 + g011
        near[6, k], far[6, k] = g100 - g101, g100 + g101
        near[7, k], far[7, k] = g110 - g111, g110 + g111
        near[8, k], far[8, k] = -h001, h001
        near[9, k], far[9, k] = h010 - h011, h010 + h011
        near[10, k], far[10, k] = h100 - h101, h100 + h101
        near[11, k], far[11, k] = h110 - h111, h110 + h111


@compiled(fastmath=True)
def _spread(near, far, i, i1, j, j1, out):  # type: ignore[no-untyped-def]
    """Add the forces on the amplitudes of a row of bricks to its nodes."""
    nz = out.shape[3]
    for v in range(12):
        for k in range(nz - 1, 0, -1):
            near[v, k] += far[v, k - 1]
        near[v, 0] += far[v, nz - 1]
    for c in range(3):
        p, q, r, s = out[c, i, j], out[c, i1, j], out[c, i, j1], out[c, i1, j1]
        a, b, d, e = near[4 * c], near[4 * c + 1], near[4 * c + 2], near[4 * c + 3]
        for k in range(nz):
            p[k] += a[k] - b[k] - d[k] + e[k]
        for k in range(nz):
            q[k] += a[k] - b[k] + d[k] - e[k]
        for k in range(nz):
            r[k] += a[k] + b[k] - d[k] - e[k]
        for k in range(nz):
            s[k] += a[k] + b[k] + d[k] + e[k]


@compiled(fastmath=True)
def _forces(begin, end, colour, u, mean, lame, shear, edges, out):  # type: ignore[no-untyped-def]
    """Add the forces of the bricks in strips in x of the same colour, which share no node."""
    nx, ny, nz = lame.shape
    scale = (0.25 / edges[0], 0.25 / edges[1], 0.25 / edges[2])
    volume = edges[0] * edges[1] * edges[2]
    for strip in range(begin, end):
        i = 2 * strip + colour if colour < 2 else nx - 1
        i1 = (i + 1) % nx
        rows = np.empty((12, nz + 1))
        near, far = np.empty((12, nz)), np.empty((12, nz))
        for j in range(ny):
            if not np.any(shear[i, j]):
                continue
            j1 = (j + 1) % ny
            _rows(u, i, i1, j, j1, rows)
            _row_forces(rows, mean, lame[i, j], shear[i, j], scale, volume, near, far)
            _spread(near, far, i, i1, j, j1, out)


@compiled(fastmath=True)
def _stress(begin, end, u, mean, lame, shear, edges, total):  # type: ignore[no-untyped-def]
    """Sum the mean stresses of the bricks, in a row of ``total`` for each place along x."""
    nx, ny, nz = lame.shape
    x, y, z = 0.25 / edges[0], 0.25 / edges[1], 0.25 / edges[2]
    for i in range(begin, end):
        rows = np.empty((12, nz + 1))
        for j in range(ny):
            _rows(u, i, (i + 1) % nx, j, (j + 1) % ny, rows)
            for k in range(nz):
                lam, mu = lame[i, j, k], shear[i, j, k]
                xx = x * (rows[2, k] + rows[2, k + 1]) + mean[0]
                yy = y * (rows[5, k] + rows[5, k + 1]) + mean[1]
                zz = z * (rows[8, k + 1] - rows[8, k]) + mean[2]
                yz = z * (rows[4, k + 1] - rows[4, k]) + y * (rows[9, k] + rows[9, k + 1])
                xz = z * (rows[0, k + 1] - rows[0, k]) + x * (rows[10, k] + rows[10, k + 1])
                xy = y * (rows[1, k] + rows[1, k + 1]) + x * (rows[6, k] + rows[6, k + 1])
                pressure = lam * (xx + yy + zz)
                total[i, 0] += pressure + 2.0 * mu * xx
                total[i, 1] += pressure + 2.0 * mu * yy
                total[i, 2] += pressure + 2.0 * mu * zz
                total[i, 3] += mu * (yz + mean[3])
                total[i, 4] += mu * (xz + mean[4])
                total[i, 5] += mu * (xy + mean[5])


@compiled(fastmath=True)
def _invert(  # type: ignore[no-untyped-def]
    begin, end, values, along_x, along_y, along_z, lame, shear, edges
):
    """Multiply by the inverse of (1) for every wavenumber; the mean motion is zero."""
    ny, nz = values.shape[2:]
    volume = 4.0 * edges[0] * edges[1] * edges[2]
    for i in range(begin, end):
        sx, cx = along_x[0, i] / edges[0], along_x[1, i]
        mx, kx = cx * cx + (along_x[0, i] * along_x[0, i]) / 3.0, sx * sx
        for j in range(ny):
            sy, cy = along_y[0, j] / edges[1], along_y[1, j]
            my, ky = cy * cy + (along_y[0, j] * along_y[0, j]) / 3.0, sy * sy
            for k in range(nz):
                if i + j + k == 0:
                    values[0, 0, 0, 0] = values[1, 0, 0, 0] = values[2, 0, 0, 0] = 0.0
                    continue
                sz, cz = along_z[0, k] / edges[2], along_z[1, k]
                mz, kz = cz * cz + (along_z[0, k] * along_z[0, k]) / 3.0, sz * sz
                px, py, pz = kx * my * mz, ky * mx * mz, kz * mx * my
                laplace = shear * (px + py + pz)
                xx = volume * (laplace + (lame + shear) * px)
                yy = volume * (laplace + (lame + shear) * py)
                zz = volume * (laplace + (lame + shear) * pz)
                xy = volume * (lame + shear) * sx * cx * sy * cy * mz
                xz = volume * (lame + shear) * sx * cx * sz * cz * my
                yz = volume * (lame + shear) * sy * cy * sz * cz * mx
                a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
                d, e, f = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
                inverse = 1.0 / (xx * a + xy * b + xz * c)
                u, v, w = values[0, i, j, k], values[1, i, j, k], values[2, i, j, k]
                values[0, i, j, k] = inverse * (a * u + b * v + c * w)
                values[1, i, j, k] = inverse * (b * u + d * v + e * w)
                values[2, i, j, k] = inverse * (c * u + e * v + f * w)

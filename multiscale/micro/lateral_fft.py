r"""Exact inverse of the flat, laterally homogeneous, periodic layered cell in O(N log n).

On a flat mesh with moduli that vary with depth only, the stiffness is block circulant in x and y.
A lateral Fourier transform leaves one block-tridiagonal system of 3 x 3 blocks per wavenumber.
Multiplying the in-plane components by the imaginary unit makes every block real and symmetric.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import scipy

from multiscale.numerics.compiled import compiled, prange, thread_count

__all__ = ["LateralInverse", "SurfaceFilter", "brick_stiffness", "factorise_flat_cell"]

SLAB = 2**20  # bytes of displacements that are transformed at once, within the second-level cache
MANY = 2**16  # points of a surface from which contact on it takes several threads
WAVES = 64  # along x whose factors are computed at once in double precision


def brick_stiffness(
    edges: tuple[float, float, float], lame: float, shear: float, *, mean_dilatation: bool = False
) -> np.ndarray:
    r"""Stiffness of a trilinear brick with 2 x 2 x 2 Gauss points.

    Parameters
    ----------
    edges : tuple of float, lengths along x, y and z, m
    lame, shear : float
        Lame's parameters, Pa.
    mean_dilatation : bool, whether the divergence is averaged over the element (B-bar)

    Returns
    -------
    ndarray, shape (2, 2, 2, 3, 2, 2, 2, 3)
        :math:`K_{abc\,i,\,a'b'c'\,j}` with the corner's place along x, y, z and the component, N/m.
    """
    # one-dimensional integrals of N N', N dN' and dN dN' on the unit edge
    mass = np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0
    mixed = np.array([[-0.5, 0.5], [-0.5, 0.5]])
    stiff = np.array([[1.0, -1.0], [-1.0, 1.0]])
    volume = float(np.prod(edges))

    def integral(i: int, j: int) -> np.ndarray:
        """Integrate dN_a/dx_i dN_b/dx_j over the brick."""
        both = {(True, True): stiff, (True, False): mixed.T, (False, True): mixed}
        factors = [both.get((k == i, k == j), mass) for k in range(3)]
        product = np.einsum("ad,be,cf->abcdef", *factors)
        return np.asarray(product * volume / (edges[i] * edges[j]))

    forms = np.array([[integral(i, j) for j in range(3)] for i in range(3)])
    stiffness = lame * forms + shear * np.swapaxes(forms, 0, 1)
    for i in range(3):
        stiffness[i, i] += shear * np.trace(forms)
    if mean_dilatation:
        sign, ones = np.array([-1.0, 1.0]), np.ones(2)
        rows = [[sign if k == i else ones for k in range(3)] for i in range(3)]
        gradient = np.array(
            [np.einsum("a,b,c->abc", *rows[i]) * volume / (4.0 * edges[i]) for i in range(3)]
        )
        mean = np.einsum("iabc,jdef->ijabcdef", gradient, gradient) / volume
        stiffness += (lame + 2.0 * shear / 3.0) * (mean - forms)
    return np.asarray(np.moveaxis(stiffness, (0, 1), (3, 7)))


@compiled(parallel=True, fastmath=True)
def _factorise(stencil, nx, ny, first, inverse, upper):  # type: ignore[no-untyped-def]
    """Block factorisation for the wavenumbers along x from ``first`` on.

    The entries are ``stencil[layer, c, c', dx, dy, i, j]``.
    """
    layers, m = stencil.shape[0], ny // 2 + 1
    for k in prange(inverse.shape[0]):
        cosine, sine = np.empty((3, 3)), np.empty((3, 3))
        diagonal, previous = np.empty((3, 3)), np.empty((3, 3))
        pivot, product = np.empty((3, 3)), np.empty((3, 3))
        for j in range(m):
            for a in range(3):
                for b in range(3):
                    angle = 2.0 * np.pi * ((first + k) * (a - 1) / nx + j * (b - 1) / ny)
                    cosine[a, b], sine[a, b] = np.cos(angle), np.sin(angle)
            for layer in range(layers):  # node plane between the layers layer and layer + 1
                for r in range(3):
                    for c in range(3):
                        own, above = 0.0, 0.0
                        for a in range(3):
                            for b in range(3):
                                phase = cosine[a, b]
                                if r < 2 and c == 2:
                                    phase = sine[a, b]
                                elif r == 2 and c < 2:
                                    phase = -sine[a, b]
                                own += stencil[layer, 1, 1, a, b, r, c] * phase
                                if layer + 1 < layers:
                                    own += stencil[layer + 1, 0, 0, a, b, r, c] * phase
                                    above += stencil[layer + 1, 0, 1, a, b, r, c] * phase
                        diagonal[r, c] = own
                        upper[k, layer, 3 * r + c, j] = above
                if layer > 0:
                    for r in range(3):
                        for c in range(3):
                            previous[r, c] = upper[k, layer - 1, 3 * r + c, j]
                    product[:] = 0.0
                    for r in range(3):
                        for s in range(3):
                            for c in range(3):
                                product[r, c] += pivot[r, s] * previous[s, c]
                    for r in range(3):
                        for s in range(3):
                            for c in range(3):
                                diagonal[r, c] -= previous[s, r] * product[s, c]
                xx, yy, zz = diagonal[0, 0], diagonal[1, 1], diagonal[2, 2]
                xy = 0.5 * (diagonal[0, 1] + diagonal[1, 0])
                xz = 0.5 * (diagonal[0, 2] + diagonal[2, 0])
                yz = 0.5 * (diagonal[1, 2] + diagonal[2, 1])
                a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
                scale = 1.0 / (xx * a + xy * b + xz * c)
                pivot[0, 0], pivot[0, 1], pivot[0, 2] = scale * a, scale * b, scale * c
                pivot[1, 1], pivot[1, 2] = scale * (xx * zz - xz * xz), scale * (xy * xz - xx * yz)
                pivot[2, 2] = scale * (xx * yy - xy * xy)
                pivot[1, 0], pivot[2, 0], pivot[2, 1] = pivot[0, 1], pivot[0, 2], pivot[1, 2]
                entries = inverse[k, layer]
                entries[0, j], entries[1, j], entries[2, j] = pivot[0, 0], pivot[0, 1], pivot[0, 2]
                entries[3, j], entries[4, j], entries[5, j] = pivot[1, 1], pivot[1, 2], pivot[2, 2]


@compiled(fastmath=True, forceinline=True)
def _rotate(values, sign, m):  # type: ignore[no-untyped-def]
    """Multiply the in-plane components of a node plane by ``sign`` times the imaginary unit."""
    for component in range(2):
        row = values[component]
        for j in range(m):
            real = row[2 * j]
            row[2 * j] = -sign * row[2 * j + 1]
            row[2 * j + 1] = sign * real


@compiled(parallel=True, fastmath=True)
def _forward(inverse, upper, values):  # type: ignore[no-untyped-def]
    """Eliminate upwards from the base; ``values`` becomes pivot times reduced right-hand side.

    The last axis of ``values`` interleaves real and imaginary parts; the blocks are real.
    """
    nx, layers, _, m = inverse.shape
    for k in prange(nx):
        for layer in range(layers):
            d = inverse[k, layer]
            now = values[k, layer]
            _rotate(now, -1.0, m)
            if layer > 0:
                w, old = upper[k, layer - 1], values[k, layer - 1]
                for j in range(m):
                    for part in range(2):
                        v = 2 * j + part
                        x, y, z = old[0, v], old[1, v], old[2, v]
                        now[0, v] -= w[0, j] * x + w[3, j] * y + w[6, j] * z
                        now[1, v] -= w[1, j] * x + w[4, j] * y + w[7, j] * z
                        now[2, v] -= w[2, j] * x + w[5, j] * y + w[8, j] * z
            for j in range(m):
                for part in range(2):
                    v = 2 * j + part
                    x, y, z = now[0, v], now[1, v], now[2, v]
                    now[0, v] = d[0, j] * x + d[1, j] * y + d[2, j] * z
                    now[1, v] = d[1, j] * x + d[3, j] * y + d[4, j] * z
                    now[2, v] = d[2, j] * x + d[4, j] * y + d[5, j] * z


@compiled(parallel=True, fastmath=True)
def _backward(inverse, upper, values):  # type: ignore[no-untyped-def]
    """Substitute downwards from the surface."""
    nx, layers, _, m = inverse.shape
    for k in prange(nx):
        for layer in range(layers - 2, -1, -1):
            d, w = inverse[k, layer], upper[k, layer]
            now, above = values[k, layer], values[k, layer + 1]
            for j in range(m):
                for part in range(2):
                    v = 2 * j + part
                    x, y, z = above[0, v], above[1, v], above[2, v]
                    a = w[0, j] * x + w[1, j] * y + w[2, j] * z
                    b = w[3, j] * x + w[4, j] * y + w[5, j] * z
                    c = w[6, j] * x + w[7, j] * y + w[8, j] * z
                    now[0, v] -= d[0, j] * a + d[1, j] * b + d[2, j] * c
                    now[1, v] -= d[1, j] * a + d[3, j] * b + d[4, j] * c
                    now[2, v] -= d[2, j] * a + d[4, j] * b + d[5, j] * c
            _rotate(above, 1.0, m)
        _rotate(values[k, 0], 1.0, m)


@dataclass(frozen=True)
class LateralInverse:
    """Factors of the flat cell, whose base is clamped.

    Attributes
    ----------
    shape : tuple of int, points in x, layers, points in y
    inverse, upper : ndarray
        Inverse pivots (6 entries of a symmetric block) and coupling blocks to the plane above,
        shapes ``(nx, layers, 6, ny // 2 + 1)`` and ``(nx, layers, 9, ny // 2 + 1)``.
    threads : int, threads of the Fourier transforms over the whole cell
    scale : float
        Stiffness by which the factors are divided, N/m, so that they fit single precision.
    """

    shape: tuple[int, int, int]
    inverse: np.ndarray
    upper: np.ndarray
    threads: int
    scale: float = 1.0

    @cached_property
    def surface_compliance(self) -> np.ndarray:
        """Symbol of the surface compliance, shape (6, nx, ny // 2 + 1), m/N.

        The entries xx, xy, xz, yy, yz, zz of a real symmetric matrix per wavenumber, for the
        in-plane components multiplied by the imaginary unit.
        """
        return np.moveaxis(self.inverse[:, -1].astype(float), 1, 0) / self.scale

    def solve(
        self,
        force: np.ndarray | None,
        correct: Callable[[np.ndarray], np.ndarray] | None = None,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        r"""Solve the flat problem for nodal forces.

        Parameters
        ----------
        force : ndarray, shape (nx, layers, 3, ny), or None
            N; None for none.
        correct : callable, optional
            Gets the displacement of the surface under ``force``, shape (nx, 3, ny), m, and returns
            a nodal force on the surface, N, that is added before the displacement below is
            computed: a constrained solve for the price of a free one.
        out : ndarray, optional
            Takes the displacement; may be ``force``.

        Returns
        -------
        ndarray, shape (nx, layers, 3, ny)
            Displacement, m.
        """
        nx, layers, ny = self.shape
        transform, values = self._workspace, self._workspace.view(self.inverse.dtype)
        dtype = np.float64 if force is None else force.dtype
        size = 1.0  # of the forces, which then cannot underflow in single precision
        if force is None:
            transform[:] = 0.0
        else:
            size = float(np.linalg.norm(force)) or 1.0
            self._over_slabs(partial(self._transform, force, 1.0 / size))
            scipy.fft.fft(transform, axis=0, workers=self.threads, overwrite_x=True)
            _forward(self.inverse, self.upper, values)
        if correct is not None:
            surface = transform[:, -1].astype(complex)  # in units, which may be beyond single range
            moved = self._to_points(surface) * (size / self.scale)
            added = self._to_wavenumbers(correct(moved)) * (self.scale / size)
            transform[:, -1] += _multiply_symbol(self.surface_compliance, added)
        _backward(self.inverse, self.upper, values)
        scipy.fft.ifft(transform, axis=0, workers=self.threads, overwrite_x=True)
        found = np.empty((nx, layers, 3, ny), dtype) if out is None else out
        self._over_slabs(partial(self._transform_back, size / self.scale, found))
        return found

    @cached_property
    def _workspace(self) -> np.ndarray:
        """Transforms of the whole cell, written by every solve."""
        (nx, layers, _), m = self.shape, self.inverse.shape[3]
        return np.empty((nx, layers, 3, m), np.result_type(self.inverse.dtype, np.complex64))

    def _over_slabs(self, work: Callable[[slice], None]) -> None:
        """Work on slabs of points along x, which fit into the cache, in threads."""
        nx, layers, ny = self.shape
        rows = max(1, SLAB // (24 * layers * ny))
        slabs = [slice(k, k + rows) for k in range(0, nx, rows)]
        if min(self.threads, len(slabs)) == 1:
            for slab in slabs:
                work(slab)
            return
        with ThreadPoolExecutor(self.threads) as pool:
            list(pool.map(work, slabs))

    def _transform(self, force: np.ndarray, factor: float, slab: slice) -> None:
        """Transform forces times a factor along y, into the workspace."""
        scaled = np.multiply(force[slab], factor, dtype=self.inverse.dtype, casting="same_kind")
        self._workspace[slab] = scipy.fft.rfft(scaled, axis=3)

    def _transform_back(self, factor: float, out: np.ndarray, slab: slice) -> None:
        """Transform the workspace back along y, and multiply by a factor."""
        values = scipy.fft.irfft(self._workspace[slab], n=self.shape[2], axis=3, overwrite_x=True)
        np.multiply(values, factor, out=out[slab])

    def surface_response(self, force: np.ndarray) -> np.ndarray:
        """Displacement of the surface under forces on the surface, shapes (nx, 3, ny)."""
        return self._to_points(
            _multiply_symbol(self.surface_compliance, self._to_wavenumbers(force))
        )

    def surface_force(self, displacement: np.ndarray) -> np.ndarray:
        """Find the forces on the surface that move it: inverse of :meth:`surface_response`."""
        return self._to_points(
            _multiply_symbol(self._surface_stiffness, self._to_wavenumbers(displacement))
        )

    @cached_property
    def _surface_stiffness(self) -> np.ndarray:
        """Inverse of :attr:`surface_compliance` for each wavenumber."""
        xx, xy, xz, yy, yz, zz = self.surface_compliance
        a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        rest = [xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy]
        return np.asarray(np.stack([a, b, c, *rest]) / (xx * a + xy * b + xz * c))

    def _to_wavenumbers(self, values: np.ndarray) -> np.ndarray:
        transform = scipy.fft.rfft2(values, axes=(0, 2))
        transform[:, :2] *= -1j
        return np.asarray(transform)

    def _to_points(self, transform: np.ndarray) -> np.ndarray:
        turned = transform.copy()
        turned[:, :2] *= 1j
        nx, _, ny = self.shape
        return np.asarray(scipy.fft.irfft2(turned, s=(nx, ny), axes=(0, 2)))


def _multiply_symbol(symbol: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Multiply a vector field by a real symmetric matrix, both per wavenumber."""
    xx, xy, xz, yy, yz, zz = symbol
    x, y, z = values[:, 0], values[:, 1], values[:, 2]
    return np.stack(
        [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z], axis=1
    )


@dataclass(frozen=True, eq=False)
class SurfaceFilter:
    """Multiplication of fields on the surface by a number per wavenumber, such as a compliance.

    Attributes
    ----------
    symbol : ndarray, shape (nx, ny // 2 + 1), the numbers
    """

    symbol: np.ndarray

    @cached_property
    def _transform(self) -> np.ndarray:
        """Transform of a field, written by every call: new memory costs more than a transform."""
        return np.empty(self.symbol.shape, complex)

    @property
    def coarse(self) -> "SurfaceFilter":
        """The compliance of every other point, if the symbol takes nodal forces; nx is even."""
        nx, m = self.symbol.shape
        rows = np.arange(nx // 2)
        rows[nx // 4 + 1 :] += nx // 2
        return SurfaceFilter(0.25 * self.symbol[rows, : m // 2 + 1])

    @cached_property
    def _single(self) -> np.ndarray:
        """The numbers in single precision."""
        return self.symbol.astype(np.float32)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Multiply a field, shape (nx, ny), in its own precision."""
        threads = thread_count() if values.size >= MANY else 1
        if values.dtype == np.float32:
            waves = scipy.fft.rfft2(values, workers=threads)
            waves *= self._single
            options = {"workers": threads, "overwrite_x": True}
            return np.asarray(scipy.fft.irfft2(waves, values.shape, **options))
        symbol, transform, found = self.symbol, self._transform, np.empty(values.shape)

        def along_y(rows: slice) -> None:
            np.fft.rfft(values[rows], axis=1, out=transform[rows])

        def along_x(columns: slice) -> None:
            part = transform[:, columns]
            np.fft.fft(part, axis=0, out=part)
            part *= symbol[:, columns]
            np.fft.ifft(part, axis=0, out=part)

        def back(rows: slice) -> None:
            np.fft.irfft(transform[rows], values.shape[1], axis=1, out=found[rows])

        nx, m = symbol.shape
        stages = (along_y, nx), (along_x, m), (back, nx)
        if threads == 1:
            for work, size in stages:
                work(slice(size))
            return found
        with ThreadPoolExecutor(threads) as pool:
            for work, size in stages:
                ends = np.linspace(0, size, threads + 1).astype(int).tolist()
                list(pool.map(work, map(slice, ends[:-1], ends[1:])))
        return found


def factorise_flat_cell(
    shape: tuple[int, int],
    spacing: tuple[float, float],
    planes: np.ndarray,
    lame: np.ndarray,
    shear: np.ndarray,
    *,
    mean_dilatation: bool = False,
    dtype: type[np.floating] = np.float64,
) -> LateralInverse:
    r"""Factorise the flat, periodic, layered cell whose base is held.

    Parameters
    ----------
    shape : tuple of int, points in x and y
    spacing : tuple of float, distances between points, m
    planes : ndarray, shape (layers + 1,), heights of the node planes, m
    lame, shear : ndarray, shape (layers,)
        Lame's parameters of each layer, Pa.
    mean_dilatation : bool, as in :func:`brick_stiffness`
    dtype : type
        ``np.float32`` halves the memory of the factors and takes a third off the time of a solve,
        whose relative error is then about 1e-6; forces and compliances are scaled to its range.
    """
    (nx, ny), layers = shape, len(planes) - 1
    # stiffness between the nodes of each layer, by their lateral distance
    stencil = np.zeros((layers, 2, 2, 3, 3, 3, 3))
    for layer in range(layers):
        edges = (*spacing, planes[layer + 1] - planes[layer])
        brick = brick_stiffness(edges, lame[layer], shear[layer], mean_dilatation=mean_dilatation)
        for a, b, d, e in np.ndindex(2, 2, 2, 2):  # from corner (a, b) to corner (d, e)
            block = brick[a, b, :, :, d, e, :, :]  # (c, i, c', j)
            stencil[layer, :, :, d - a + 1, e - b + 1] += np.moveaxis(block, 1, 2)
    m = ny // 2 + 1
    inverse = np.empty((nx, layers, 6, m), dtype)
    upper = np.empty((nx, layers, 9, m), dtype)
    scale = float(np.max(np.abs(stencil)))
    for first in range(0, nx, WAVES):
        waves = slice(first, min(first + WAVES, nx))
        pivots, blocks = (np.empty((waves.stop - first, *of.shape[1:])) for of in (inverse, upper))
        _factorise(stencil / scale, nx, ny, first, pivots, blocks)
        inverse[waves], upper[waves] = pivots, blocks
    return LateralInverse((nx, layers, ny), inverse, upper, thread_count(), scale)

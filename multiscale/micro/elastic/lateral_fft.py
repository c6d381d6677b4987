r"""Exact inverse of the flat, laterally homogeneous, periodic layered cell in O(N log n).

A lateral Fourier transform, with in-plane components multiplied by the imaginary unit, leaves a
real block-tridiagonal system per wavenumber. With

.. math:: s = \frac{4 \sin^2 \theta/2}{h}, \quad m = h (1 - \tfrac23 \sin^2 \theta/2), \quad
    \bar m = h \cos^2 \theta/2, \quad t = \sin \theta

for the phase angles of a mode along x and along y, the block between two node planes is

.. math::
    K_{xx} &= s_x (a\, m_y + b\, \bar m_y) + m_x (c\, s_y + d\, m_y), \quad
    K_{xy} = g\, t_x t_y, \quad K_{xz} = t_x (p\, m_y + q\, \bar m_y), \\
    K_{zz} &= e\, m_x m_y + f\, \bar m_x \bar m_y + c\, (s_x m_y + m_x s_y),    \tag{1}

likewise :math:`K_{yy}` and :math:`K_{yz}`; from a plane to the next plane above,
:math:`K_{zx} = -K_{xz}` and :math:`K_{zy} = -K_{yz}`. The factors a to q come from integrals over
the depth of the layers between, the terms of means from the mean dilatation (B-bar).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import scipy

from multiscale.executors import run_ranges, thread_count
from multiscale.numerics.compiled import compiled

SLAB = 2**20  # bytes of displacements in a slab, which fits into the second-level cache
MANY = 2**16  # fewest points of a surface for several threads
LEAST = 2**17  # fewest pivots, or factors of pivots, for a thread
MODES = 64  # wavenumbers along x that are factorised at once in double precision


@compiled(fastmath=True, forceinline=True)
def _block(between, x, k, y, j):  # type: ignore[no-untyped-def]
    """Stiffness between two node planes for a mode, (1): entries xx, xy, xz, yy, yz and zz."""
    a, b, c, d, e = between[0], between[1], between[2], between[3], between[4]
    f, g, p, q = between[5], between[6], between[7], between[8]
    stiff_x, mass_x, mean_x, sine_x = x[0, k], x[1, k], x[2, k], x[3, k]
    stiff_y, mass_y, mean_y, sine_y = y[0, j], y[1, j], y[2, j], y[3, j]
    across = stiff_x * mass_y + mass_x * stiff_y
    return (
        stiff_x * (a * mass_y + b * mean_y) + mass_x * (c * stiff_y + d * mass_y),
        g * sine_x * sine_y,
        sine_x * (p * mass_y + q * mean_y),
        stiff_y * (a * mass_x + b * mean_x) + mass_y * (c * stiff_x + d * mass_x),
        sine_y * (p * mass_x + q * mean_x),
        e * mass_x * mass_y + f * mean_x * mean_y + c * across,
    )


@compiled(fastmath=True, forceinline=True)
def _times(matrix, x, y, z):  # type: ignore[no-untyped-def]
    xx, xy, xz, yy, yz, zz = matrix
    return xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z


@compiled(fastmath=True)
def _factorise(begin, end, within, above, x, y, inverse):  # type: ignore[no-untyped-def]
    """Invert the pivots of the block factorisation, from the base up."""
    for k in range(begin, end):
        for layer in range(inverse.shape[1]):  # node plane between this layer and the next
            pivot = inverse[k, layer]
            for j in range(inverse.shape[3]):
                xx, xy, xz, yy, yz, zz = _block(within[layer], x, k, y, j)
                if layer > 0:
                    d = inverse[k, layer - 1, :, j]
                    d = d[0], d[1], d[2], d[3], d[4], d[5]
                    u = _block(above[layer - 1], x, k, y, j)
                    a, b, c = _times(d, u[0], u[1], -u[2])
                    xx -= u[0] * a + u[1] * b - u[2] * c
                    xy -= u[1] * a + u[3] * b - u[4] * c
                    xz -= u[2] * a + u[4] * b + u[5] * c
                    a, b, c = _times(d, u[1], u[3], -u[4])
                    yy -= u[1] * a + u[3] * b - u[4] * c
                    yz -= u[2] * a + u[4] * b + u[5] * c
                    a, b, c = _times(d, u[2], u[4], u[5])
                    zz -= u[2] * a + u[4] * b + u[5] * c
                a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
                scale = 1.0 / (xx * a + xy * b + xz * c)
                pivot[0, j], pivot[1, j], pivot[2, j] = scale * a, scale * b, scale * c
                pivot[3, j] = scale * (xx * zz - xz * xz)
                pivot[4, j] = scale * (xy * xz - xx * yz)
                pivot[5, j] = scale * (xx * yy - xy * xy)


@compiled(fastmath=True, forceinline=True)
def _rotate(values, sign, m):  # type: ignore[no-untyped-def]
    """Multiply the in-plane components of a node plane by ``sign`` times the imaginary unit."""
    for component in range(2):
        row = values[component]
        for j in range(m):
            real = row[2 * j]
            row[2 * j] = -sign * row[2 * j + 1]
            row[2 * j + 1] = sign * real


@compiled(fastmath=True, forceinline=True)
def _row(k, nx, inverse):  # type: ignore[no-untyped-def]
    """Row of a mode along x, or of its mirror image, and the sign of terms odd in x."""
    real = inverse.dtype.type
    return (k, real(1.0)) if 2 * k <= nx else (nx - k, real(-1.0))


@compiled(fastmath=True, forceinline=True)
def _pivot(d, sign, v):  # type: ignore[no-untyped-def]
    """Inverse pivot of a mode, from its stored value or its mirror image."""
    return d[0, v], sign * d[1, v], sign * d[2, v], d[3, v], d[4, v], d[5, v]


@compiled(fastmath=True)
def _forward(begin, end, inverse, above, x, y, values):  # type: ignore[no-untyped-def]
    """Eliminate upwards from the base; ``values`` becomes pivot times reduced right-hand side."""
    nx, layers, _, m = values.shape
    for k in range(begin, end):
        row, sign = _row(k, nx, inverse)
        passed, reduced = np.zeros((3, m), values.dtype), np.empty((3, m), values.dtype)
        for layer in range(layers):
            now, d = values[k, layer], inverse[row, layer]
            _rotate(now, -1.0, m // 2)
            for v in range(m):
                x0, y0 = now[0, v] - passed[0, v], now[1, v] - passed[1, v]
                z0 = now[2, v] - passed[2, v]
                reduced[0, v], reduced[1, v], reduced[2, v] = _times(_pivot(d, sign, v), x0, y0, z0)
            now[:] = reduced
            if layer + 1 < layers:
                between = above[layer]
                for v in range(m):
                    w = _block(between, x, k, y, v)
                    a, b, c = reduced[0, v], reduced[1, v], reduced[2, v]
                    passed[0, v] = w[0] * a + w[1] * b - w[2] * c
                    passed[1, v] = w[1] * a + w[3] * b - w[4] * c
                    passed[2, v] = w[2] * a + w[4] * b + w[5] * c


@compiled(fastmath=True)
def _backward(begin, end, inverse, above, x, y, values):  # type: ignore[no-untyped-def]
    nx, layers, _, m = values.shape
    for k in range(begin, end):
        row, sign = _row(k, nx, inverse)
        for layer in range(layers - 2, -1, -1):
            now, old = values[k, layer], values[k, layer + 1]
            d, between = inverse[row, layer], above[layer]
            for v in range(m):
                w = _block(between, x, k, y, v)
                a, b, c = old[0, v], old[1, v], old[2, v]
                a, b, c = _times(
                    _pivot(d, sign, v),
                    w[0] * a + w[1] * b + w[2] * c,
                    w[1] * a + w[3] * b + w[4] * c,
                    w[5] * c - w[2] * a - w[4] * b,
                )
                now[0, v] -= a
                now[1, v] -= b
                now[2, v] -= c
            _rotate(old, 1.0, m // 2)
        _rotate(values[k, 0], 1.0, m // 2)


@dataclass(frozen=True)
class LateralInverse:
    """Factors of the flat cell on a clamped base."""

    shape: tuple[int, int, int]  # points in x, layers, points in y
    inverse: np.ndarray  # (nx // 2 + 1, layers, 6, 2 (ny // 2 + 1)), inverse pivots, repeated
    coupling: tuple[np.ndarray, np.ndarray, np.ndarray]  # factors of (1) upwards, modes in x and y
    scale: float = 1.0  # stiffness by which the factors are divided, N/m, for single precision

    @cached_property
    def surface_compliance(self) -> np.ndarray:
        """Symbol of the surface compliance, xx, xy, xz, yy, yz, zz, (6, nx, ny // 2 + 1), m/N."""
        return self._pivots.astype(float) / self.scale

    @cached_property
    def _pivots(self) -> np.ndarray:
        nx = self.shape[0]
        rows = np.arange(nx)
        pivots = self.inverse[np.minimum(rows, nx - rows), -1, :, ::2]
        pivots[nx // 2 + 1 :, 1:3] *= -1.0
        return np.ascontiguousarray(np.moveaxis(pivots, 1, 0))

    def solve(
        self,
        force: np.ndarray | None,
        correct: Callable[[np.ndarray], np.ndarray] | None = None,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        r"""Solve the flat problem for nodal forces."""
        nx, layers, ny = self.shape
        transform, values = self._workspace, self._workspace.view(self.inverse.dtype)
        dtype = np.float64 if force is None else force.dtype
        size = 1.0  # norm of the forces: avoids underflow in single precision
        if force is None:
            transform[:] = 0.0
        else:
            size = float(np.linalg.norm(force)) or 1.0
            self._over_slabs(partial(self._transform, force, 1.0 / size))
            scipy.fft.fft(transform, axis=0, workers=thread_count(), overwrite_x=True)
            self._substitute(_forward, values)
        if correct is not None:
            moved = self._to_points(transform[:, -1]) * np.float64(size / self.scale)
            added = (correct(moved) / size).astype(self.inverse.dtype)
            transform[:, -1] += _multiply_symbol(self._pivots, self._to_wavenumbers(added))
        self._substitute(_backward, values)
        scipy.fft.ifft(transform, axis=0, workers=thread_count(), overwrite_x=True)
        displacement = np.empty((nx, layers, 3, ny), dtype) if out is None else out
        self._over_slabs(partial(self._transform_back, size / self.scale, displacement))
        return displacement

    @cached_property
    def _workspace(self) -> np.ndarray:
        """Memory for the transform of the whole cell, overwritten by every solve."""
        (nx, layers, _), m = self.shape, self.inverse.shape[3] // 2
        return np.empty((nx, layers, 3, m), np.result_type(self.inverse.dtype, np.complex64))

    def _substitute(self, kernel: Callable[..., None], values: np.ndarray) -> None:
        """Eliminate or substitute, wavenumber by wavenumber along x."""
        nx, layers, _, m = values.shape
        least = -(-LEAST // (layers * m))
        run_ranges(kernel, nx, self.inverse, *self.coupling, values, least=least)

    def _over_slabs(self, work: Callable[[slice], None]) -> None:
        """Call ``work`` on slabs of points along x, which fit into the cache, in threads."""
        nx, layers, ny = self.shape
        rows = max(1, SLAB // (24 * layers * ny))

        def run(begin: int, end: int) -> None:
            for k in range(begin, end):
                work(slice(k * rows, (k + 1) * rows))

        run_ranges(run, -(-nx // rows))

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
        """Return the forces for a displacement: the inverse of :meth:`surface_response`."""
        return self._to_points(
            _multiply_symbol(self._surface_stiffness, self._to_wavenumbers(displacement))
        )

    @cached_property
    def _surface_stiffness(self) -> np.ndarray:
        xx, xy, xz, yy, yz, zz = self.surface_compliance
        a, b, c = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
        rest = [xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy]
        return np.asarray(np.stack([a, b, c, *rest]) / (xx * a + xy * b + xz * c))

    def _to_wavenumbers(self, values: np.ndarray) -> np.ndarray:
        transform = scipy.fft.rfft2(values, axes=(0, 2), workers=thread_count())
        transform[:, :2] *= -1j
        return np.asarray(transform)

    def _to_points(self, transform: np.ndarray) -> np.ndarray:
        turned = transform.copy()
        turned[:, :2] *= 1j
        nx, _, ny = self.shape
        return np.asarray(scipy.fft.irfft2(turned, s=(nx, ny), axes=(0, 2), workers=thread_count()))


def _multiply_symbol(symbol: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Multiply a vector field by a real symmetric matrix, both per wavenumber."""
    xx, xy, xz, yy, yz, zz = symbol
    x, y, z = values[:, 0], values[:, 1], values[:, 2]
    return np.stack(
        [xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z], axis=1
    )


@dataclass(frozen=True, eq=False)
class SurfaceFilter:
    """Multiplication of fields on the surface by a number per wavenumber, such as a compliance."""

    symbol: np.ndarray  # (nx, ny // 2 + 1), the numbers

    @cached_property
    def _transform(self) -> np.ndarray:
        """Memory for transforms, overwritten by every call: new memory takes longer."""
        return np.empty(self.symbol.shape, complex)

    @property
    def coarse(self) -> "SurfaceFilter":
        """Compliance to nodal forces on every other point; nx is even."""
        nx, m = self.symbol.shape
        rows = np.arange(nx // 2)
        rows[nx // 4 + 1 :] += nx // 2
        return SurfaceFilter(0.25 * self.symbol[rows, : m // 2 + 1])

    @cached_property
    def _single(self) -> np.ndarray:
        return self.symbol.astype(np.float32)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Multiply a field, shape (nx, ny), in the precision of the field."""
        threads = thread_count() if values.size >= MANY else 1
        if values.dtype == np.float32:
            modes = scipy.fft.rfft2(values, workers=threads)
            modes *= self._single
            options = {"workers": threads, "overwrite_x": True}
            return np.asarray(scipy.fft.irfft2(modes, values.shape, **options))
        symbol, transform, filtered = self.symbol, self._transform, np.empty(values.shape)

        def along_y(begin: int, end: int) -> None:
            np.fft.rfft(values[begin:end], axis=1, out=transform[begin:end])

        def along_x(begin: int, end: int) -> None:
            columns = transform[:, begin:end]
            np.fft.fft(columns, axis=0, out=columns)
            columns *= symbol[:, begin:end]
            np.fft.ifft(columns, axis=0, out=columns)

        def back(begin: int, end: int) -> None:
            np.fft.irfft(transform[begin:end], values.shape[1], axis=1, out=filtered[begin:end])

        nx, m = symbol.shape
        for work, size in ((along_y, nx), (along_x, m), (back, nx)):
            run_ranges(work, size, least=-(-MANY * size // (2 * values.size)))
        return filtered


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
    r"""Factorise the flat, periodic, layered cell on a clamped base."""
    (nx, ny), layers = shape, len(planes) - 1
    thickness = np.diff(planes)[:, None, None]
    lame, shear = lame[:, None, None], shear[:, None, None]
    bulk = lame + 2.0 * shear / 3.0 if mean_dilatation else 0.0 * lame
    rest = lame - bulk
    # one-dimensional integrals of N N', of means of N and N', of dN dN' and of N dN' in a layer
    mass = thickness * np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0
    mean = thickness * np.full((2, 2), 0.25)
    stiff = np.array([[1.0, -1.0], [-1.0, 1.0]]) / thickness
    mixed = np.array([[-0.5, 0.5], [-0.5, 0.5]])
    factors = np.stack(
        [
            (rest + 2.0 * shear) * mass,
            bulk * mean,
            shear * mass,
            shear * stiff,
            (rest + 2.0 * shear) * stiff,
            bulk * stiff,
            (rest + shear) * mass + bulk * mean,
            shear * mixed.T - rest * mixed,
            -bulk * mixed,
        ],
        axis=-1,
    )
    # factors of the blocks (1) within a node plane and to the next plane above
    within, above = factors[:, 1, 1], factors[1:, 0, 1]
    within[:-1] += factors[1:, 0, 0]
    scale = float(np.max(within[:, 4] + within[:, 5])) * spacing[0] * spacing[1]
    modes = [
        _lateral_integrals(n, step, count)
        for n, step, count in zip(shape, spacing, (nx, ny // 2 + 1), strict=True)
    ]
    # inverse pivots, repeated for the real and imaginary parts
    inverse = np.empty((nx // 2 + 1, layers, 6, 2 * (ny // 2 + 1)), dtype)
    for first in range(0, len(inverse), MODES):
        rows = slice(first, first + MODES)
        pivots = np.empty(inverse[rows, ..., ::2].shape)
        arguments = within / scale, above / scale, modes[0][:, rows], modes[1], pivots
        run_ranges(_factorise, len(pivots), *arguments, least=-(-LEAST // (layers * ny)))
        inverse[rows, ..., ::2] = inverse[rows, ..., 1::2] = pivots
    along_x, along_y = modes[0].astype(dtype), np.repeat(modes[1], 2, axis=1).astype(dtype)
    coupling = (above / scale).astype(dtype), along_x, along_y
    return LateralInverse((nx, layers, ny), inverse, coupling, scale)


def _lateral_integrals(points: int, spacing: float, count: int) -> np.ndarray:
    """Integrals of modes, shape (4, count): dN dN', N N', means of N and N', and N dN'."""
    angle = 2.0 * np.pi * np.arange(count) / points
    square = np.sin(0.5 * angle) ** 2
    return np.array(
        [
            4.0 * square / spacing,
            spacing * (1.0 - 2.0 * square / 3.0),
            spacing * (1.0 - square),
            np.sin(angle),
        ]
    )

r"""Exact areas of plane sections of boxes and of images of voxels.

The area of the section of a box of volume V with the plane :math:`n \cdot x = d` is V times the
density at d of the sum of three independent uniform variables. Their ranges are the extents of the
edges along n. With the extents :math:`a \ge b \ge c` and the distribution F of the sum of the two
variables with the ranges b and c,

.. math:: A(t) = \frac{V}{a}\,\big(F(t) - F(t - a)\big),    \tag{1}

t being measured from the corner that the plane meets first. F is a piecewise quadratic function
that becomes a ramp and a step as c and b vanish, so that no plane needs a special formula.
"""

import numpy as np

from multiscale.numerics.compiled import compiled


def box_section(
    size: tuple[float, float, float], normal: np.ndarray, distance: np.ndarray
) -> np.ndarray:
    """Area of plane sections of a box, m², at distances from its centre along a unit normal, m."""
    a, b, c = np.sort(np.abs(normal) * size)[::-1]
    return np.array(
        [np.prod(size) * _density(d + 0.5 * (a + b + c), a, b, c) for d in distance], dtype=float
    )


def void_section(
    void: np.ndarray, size: tuple[float, float, float], normal: np.ndarray, distance: np.ndarray
) -> np.ndarray:
    """Area of void voxels, (nx, ny, nz), in plane sections of a box, m²."""
    spacing = np.array(size) / void.shape
    order = np.argsort(distance)
    step = normal * spacing
    low = -0.5 * float(np.abs(normal) @ size)
    a, b, c = np.sort(np.abs(step))[::-1]
    area = np.empty(len(order))
    planes = np.asarray(distance, dtype=float)[order] - low
    area[order] = _void_section(void, step, planes, a, b, c)
    return np.prod(spacing) * area


@compiled
def _ramp(s, b, c):  # type: ignore[no-untyped-def]
    """Distribution of the sum of two uniform variables with ranges b >= c."""
    if s <= 0.0:
        return 0.0
    if s >= b + c:
        return 1.0
    if s < c:
        return s * s / (2.0 * b * c)
    if s <= b:
        return (s - 0.5 * c) / b
    return 1.0 - (b + c - s) ** 2 / (2.0 * b * c)


@compiled
def _density(t, a, b, c):  # type: ignore[no-untyped-def]
    """Equation (1) over the volume, 1/m."""
    return (_ramp(t, b, c) - _ramp(t - a, b, c)) / a


@compiled
def _void_section(void, step, planes, a, b, c):  # type: ignore[no-untyped-def]
    """Sum (1) over the void voxels, for planes in rising order from the first corner."""
    total = np.zeros(len(planes))
    nx, ny, nz = void.shape
    extent = a + b + c
    for i in range(nx):
        x = step[0] * i if step[0] >= 0.0 else step[0] * (i + 1 - nx)
        for j in range(ny):
            y = step[1] * j if step[1] >= 0.0 else step[1] * (j + 1 - ny)
            for k in range(nz):
                if not void[i, j, k]:
                    continue
                z = step[2] * k if step[2] >= 0.0 else step[2] * (k + 1 - nz)
                corner = x + y + z
                p = np.searchsorted(planes, corner)
                while p < len(planes) and planes[p] <= corner + extent:
                    total[p] += _density(planes[p] - corner, a, b, c)
                    p += 1
    return total

r"""A rigid flat punch pressed on an elastic half-space with friction, by integral equations.

Pressure and shear act on each other here. A ball that is pressed by a growing force sticks
within the same part of its contact: its traction is a sum of the tractions of all smaller punches.
"""

from functools import cache

import numpy as np

from multiscale.errors import CaseError, ConvergenceError

MAX_ITERATIONS = 100  # limit of changes of the stick zone


def punch_with_friction(
    friction: float, poissons_ratio: float, *, rings: int = 200, coupled: bool = True
) -> tuple[float, float]:
    r"""Stick radius over the radius of a flat punch, and its force over that without friction.

    Both at the same depth, from rings of constant traction; the radius is accurate to about their
    width. Uncoupled, the shear does not act on the pressure, and the stick radius is the closed
    form :func:`~tests.closed_forms.mindlin.spence_stick_radius`. In units of the radius :math:`a`,
    the depth and :math:`G/(1-\nu)`, with :math:`\beta = (1-2\nu)/(2(1-\nu))`, pressure :math:`p`
    and outward shear :math:`q` give

    .. math::
        w &= \frac{2}{\pi} \int_0^r \frac{P(t)\,\mathrm{d}t}{\sqrt{r^2 - t^2}}
            - \beta \int_r^1 q\, \mathrm{d}s = 1, \qquad
            P(t) = \int_t^1 \frac{s\, p\, \mathrm{d}s}{\sqrt{s^2 - t^2}},    \tag{1} \\
        u &= \frac{2}{\pi r} \int_0^r \frac{t\, Q(t)\,\mathrm{d}t}{\sqrt{r^2 - t^2}}
            - \frac{\beta}{r} \int_0^r s\, p\, \mathrm{d}s, \qquad
            Q(t) = t \int_t^1 \frac{q\, \mathrm{d}s}{\sqrt{s^2 - t^2}},    \tag{2}

    where :math:`u = 0` and :math:`|q| \le \mu p` in the stick zone and :math:`q = \mu p`,
    :math:`u < 0` around it: D. A. Spence, J. Elast. 5 (1975) 297-319.

    >>> radius, force = punch_with_friction(0.3, 0.3, rings=100)
    >>> round(radius, 2), round(force, 4)
    (0.9, 1.0243)
    """
    if not friction >= 0.0 or not 0.0 <= poissons_ratio < 0.5:
        raise CaseError(
            f"friction must not be negative and poissons_ratio lie in [0, 0.5), "
            f"got {friction:g} and {poissons_ratio:g}"
        )
    beta = (1.0 - 2.0 * poissons_ratio) / (2.0 * (1.0 - poissons_ratio))
    edge, r, normal, radial = _direct_motion(rings)
    width, area = np.diff(edge), 0.5 * np.diff(edge**2)
    outside = np.triu(np.tile(width, (rings, 1)), 1) + np.diag(edge[1:] - r)
    inside = np.tril(np.tile(area, (rings, 1)), -1) + np.diag(0.5 * (r**2 - edge[:-1] ** 2))
    lift = beta * outside if coupled else np.zeros_like(outside)
    pull = beta * inside / r[:, None]

    stick = np.ones(rings, dtype=bool)
    for _ in range(MAX_ITERATIONS):
        rows = stick[:, None]
        by_p = np.where(rows, -pull, -friction * np.eye(rings))  # (2) or q = mu p
        by_q = np.where(rows, radial, np.eye(rings))
        matrix = np.block([[normal, -lift], [by_p, by_q]])
        p, q = np.linalg.solve(matrix, np.repeat([1.0, 0.0], rings)).reshape(2, rings)
        u = radial @ q - pull @ p
        new = np.where(stick, q <= friction * p, u > 0.0)
        if np.array_equal(new, stick):
            return float(edge[stick.sum()]), float(0.5 * np.pi * area @ p)
        stick = new
    raise ConvergenceError(f"the stick zone did not settle in {MAX_ITERATIONS} iterations")


@cache
def _direct_motion(rings: int) -> tuple[np.ndarray, ...]:
    """Edges and middles of rings; there the first terms of (1) and (2), for a unit on each ring."""
    edge = np.sin(np.linspace(0.0, np.pi / 2.0, rings + 1))  # finer where p is singular
    r = 0.5 * (edge[1:] + edge[:-1])
    x, weight = np.polynomial.legendre.leggauss(12)
    weight = 0.5 * np.pi * weight * np.cos(0.5 * np.pi * x)
    x = np.sin(0.5 * np.pi * x)  # takes the roots at the edges of the rings out
    normal, radial = np.zeros((2, r.size, r.size))
    for i, radius in enumerate(r):
        # t = radius sin(angle)
        cuts = np.concatenate([[0.0], np.arcsin(edge[1 : i + 1] / radius), [0.5 * np.pi]])
        half, middle = 0.5 * np.diff(cuts)[:, None], 0.5 * (cuts[1:] + cuts[:-1])[:, None]
        t = radius * np.sin(middle + half * x).ravel()[:, None]
        w = (half * weight).ravel()
        P = np.diff(np.sqrt(np.maximum(edge**2 - t**2, 0.0)), axis=1)
        Q = t * np.diff(np.arccosh(np.maximum(edge / t, 1.0)), axis=1)
        normal[i] = 2.0 / np.pi * w @ P
        radial[i] = 2.0 / np.pi / radius * (w * t[:, 0]) @ Q
    return edge, r, normal, radial

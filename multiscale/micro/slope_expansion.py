r"""Compliance of a rough surface to first order in its slopes, from the flat one below it.

A body whose top is :math:`z = h(x, y)` carries normal forces :math:`f`, along z for each projected
area, and its top moves by :math:`u_z`. Both are work-conjugate, so that the compliance is
symmetric: the complementary energy is the largest value of

.. math:: 2 \int f\, u_z\, \mathrm{d}A - \int_{z < h} \sigma : \varepsilon\, \mathrm{d}V.    \tag{1}

The fields of the flat body, continued beyond its top, have errors of first order in :math:`h`, and
(1) has errors of second order. On the flat top, which carries no shear, its first order is

.. math::
    f^t C_1 f = \int h \left(\sigma_{zz} \varepsilon_{zz}
        - \sigma_{\alpha\beta} \varepsilon_{\alpha\beta}\right) \mathrm{d}A.    \tag{2}

The top of a half-space strains in its plane by
:math:`\varepsilon_{\alpha\beta} = c\, \varphi_{,\alpha\beta}` with
:math:`c = (1 - 2\nu) / (2\mu)` and :math:`\Delta \varphi = f - \bar f`. For heights of zero mean
(2) becomes a term of the mean pressure and the determinant of the Hessian of
:math:`\varphi`, whose derivatives integration by parts moves to the heights:

.. math::
    C_1 f = c \left(\bar f\, h + \overline{h f}\right)
      + c\, (1 - 2\nu)\, \Delta^{-1} \operatorname{div} (H\, \nabla \Delta^{-1} f), \qquad
    H = \begin{pmatrix} h_{,yy} & -h_{,xy} \\ -h_{,xy} & h_{,xx} \end{pmatrix}.    \tag{3}

:math:`C_1` vanishes for incompressible bodies, :math:`\nu = 1/2`; in plane strain only the term of
the mean remains.

Two bodies, each in its own frame with z out of it and heights :math:`h_i` (so that the underside of
the second is at :math:`-h_2` above the first), touch on a surface :math:`m` between theirs. While
slopes are small and heights of short waves,

.. math::
    m = \frac{k_2 h_1 - k_1 h_2}{k_1 + k_2}, \qquad k_i = \frac{1 - \nu_i}{\mu_i}:    \tag{4}

halfway between alike bodies, and on a rigid one, :math:`k_2 = 0`. Forces act along its normal
:math:`(-\nabla m, 1)`, along which the gap closes. Beside the sum of :math:`C_1` of both bodies,
their motions in the plane, :math:`c_i \nabla \Delta^{-1} f`, which differ, and their compliance
under forces in the plane give

.. math::
    (c_1 - c_2) \left[\operatorname{div} \Delta^{-1} (f\, \nabla m)
      - \nabla m \cdot \nabla \Delta^{-1} f\right].    \tag{5}

It is proportional to Dundurs' second constant. Of alike bodies nothing but
:math:`C_1 f = c\,(\dots)` of the composite heights :math:`h_1 + h_2` is left: *half* as much as of
one body with these heights and the contact modulus of both.

The expansion of a boundary goes back to [1]_ and [2]_; (3) and (5) are derived here and are checked
against conforming cells. Strains are small: large strain has terms of the order of :math:`C_1`.

References
----------
.. [1] O. P. Bruno and F. Reitich, J. Opt. Soc. Am. A 10 (1993) 1168-1175,
   doi:10.1364/JOSAA.10.001168.
.. [2] W. Craig and C. Sulem, J. Comput. Phys. 108 (1993) 73-83, doi:10.1006/jcph.1993.1164.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import fft

from multiscale.surfaces.surface import Surface

__all__ = ["expanded_compliance"]


def expanded_compliance(
    surfaces: Sequence[Surface],
    symbol: np.ndarray,
    shear: Sequence[float],
    poissons_ratio: Sequence[float],
) -> Callable[..., np.ndarray]:
    r"""Return the symmetric :math:`C_0 + C_1` of two bodies: six transforms, two if flat."""
    (nx, ny), (dx, dy) = surfaces[0].heights.shape, surfaces[0].spacing
    h = np.stack([one.heights - np.mean(one.heights) for one in surfaces])
    mu, nu = np.asarray(shear), np.asarray(poissons_ratio)
    c = (0.5 - nu) / mu
    first, second = (1.0 - nu) / mu
    middle = (second * h[0] - first * h[1]) / (first + second)  # (4)
    q_x, q_y = 2.0 * np.pi * np.fft.fftfreq(nx, dx)[:, None], 2.0 * np.pi * np.fft.rfftfreq(ny, dy)
    # the shortest wave has no derivative on the grid
    by_x, by_y = (
        1j * np.where(np.abs(q) * step < 0.999 * np.pi, q, 0.0)
        for q, step in ((q_x, dx), (q_y, dy))
    )
    square = q_x**2 + q_y**2
    square[0, 0] = np.inf  # the mean has a term of its own
    back_x, back_y = by_x / square, by_y / square  # of the inverse of minus the Laplacian

    def to_points(transform: np.ndarray) -> np.ndarray:
        return np.asarray(fft.irfft2(transform, s=(nx, ny), overwrite_x=True))

    area = dx * dy  # of a node, over which its force is spread
    local = np.tensordot(c, h, 1) / area
    bent = fft.rfft2(np.tensordot(2.0 * c * (0.5 - nu), h, 1) / area)
    h_xx, h_yy, h_xy = (to_points(k * bent) for k in (by_x**2, by_y**2, by_x * by_y))
    tilt = fft.rfft2((c[0] - c[1]) * middle / area)
    tilt_x, tilt_y = to_points(by_x * tilt), to_points(by_y * tilt)

    def apply(force: np.ndarray, *, vertical: bool = False) -> np.ndarray:
        transform = fft.rfft2(force)
        along_x, along_y = to_points(back_x * transform), to_points(back_y * transform)
        moved = symbol * transform
        moved += back_x * fft.rfft2(h_yy * along_x - h_xy * along_y - tilt_x * force)  # (3), (5)
        moved += back_y * fft.rfft2(h_xx * along_y - h_xy * along_x - tilt_y * force)
        found = to_points(moved) + np.mean(force) * local + np.mean(local * force)
        if not vertical:
            found += tilt_x * along_x + tilt_y * along_y  # (5)
        return np.asarray(found)

    return apply

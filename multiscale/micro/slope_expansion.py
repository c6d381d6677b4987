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
the mean remains. The expansion of a boundary goes back to [1]_ and [2]_; (3) is derived here and
is checked against the conforming cell.

References
----------
.. [1] O. P. Bruno and F. Reitich, J. Opt. Soc. Am. A 10 (1993) 1168-1175,
   doi:10.1364/JOSAA.10.001168.
.. [2] W. Craig and C. Sulem, J. Comput. Phys. 108 (1993) 73-83, doi:10.1006/jcph.1993.1164.
"""

from collections.abc import Callable

import numpy as np
from scipy import fft

from multiscale.surfaces.surface import Surface

__all__ = ["expanded_compliance"]


def expanded_compliance(
    surface: Surface, symbol: np.ndarray, shear: float, poissons_ratio: float
) -> Callable[[np.ndarray], np.ndarray]:
    r"""Return :math:`C_0 + C_1` of (3), symmetric, in six transforms where the flat one has two.

    Parameters
    ----------
    surface : Surface
        Heights :math:`h`, m.
    symbol : ndarray, shape (nx, ny // 2 + 1)
        :math:`C_0` of nodal forces for ``rfft2``, m/N.
    shear, poissons_ratio : float
        :math:`\mu`, Pa, and :math:`\nu`.

    Returns
    -------
    callable
        Takes nodal forces along z, shape (nx, ny), N, and returns displacements along z, m.
    """
    heights = surface.heights - np.mean(surface.heights)
    (nx, ny), (dx, dy) = heights.shape, surface.spacing
    q_x, q_y = 2.0 * np.pi * np.fft.fftfreq(nx, dx)[:, None], 2.0 * np.pi * np.fft.rfftfreq(ny, dy)
    # the shortest wave has no derivative on the grid
    by_x, by_y = (
        1j * np.where(np.abs(q) * step < 0.999 * np.pi, q, 0.0)
        for q, step in ((q_x, dx), (q_y, dy))
    )
    square = q_x**2 + q_y**2
    square[0, 0] = np.inf  # the mean has a term of its own

    def to_points(transform: np.ndarray) -> np.ndarray:
        return np.asarray(fft.irfft2(transform, s=(nx, ny), overwrite_x=True))

    waves = fft.rfft2(heights)
    h_xx, h_yy, h_xy = (to_points(k * waves) for k in (by_x**2, by_y**2, by_x * by_y))
    local = (0.5 - poissons_ratio) / (shear * dx * dy)  # c over the area of a node, m/N
    first, second = by_x / square, by_y / square
    back_x, back_y = (2.0 * (0.5 - poissons_ratio) * local * k for k in (first, second))

    def apply(force: np.ndarray) -> np.ndarray:
        transform = fft.rfft2(force)
        along_x, along_y = to_points(first * transform), to_points(second * transform)
        moved = symbol * transform
        moved += back_x * fft.rfft2(h_yy * along_x - h_xy * along_y)
        moved += back_y * fft.rfft2(h_xx * along_y - h_xy * along_x)
        mean = np.mean(force) * heights + np.mean(heights * force)
        return np.asarray(to_points(moved) + local * mean)

    return apply

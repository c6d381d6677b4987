r"""Compliance of layered bodies, and of rough bodies to first order in their slopes.

In a layer, :math:`u_x = U \sin qx`, :math:`u_z = W \cos qx` solves Navier's equations if, with
:math:`\zeta = q z`, :math:`s = \pm 1` and :math:`\kappa = 3 - 4\nu`,

.. math::
    W &= (a + b\zeta)\, e^{s\zeta}, \qquad
    U = -(s a + \kappa b + s b \zeta)\, e^{s\zeta},    \tag{1} \\
    \sigma_{zz} &= 2 \mu q \left(s (a + b\zeta) + (1 - 2\nu) b\right) e^{s\zeta} \cos qx, \qquad
    \sigma_{xz} = -2 \mu q \left(a + b\zeta + 2 s (1 - \nu) b\right) e^{s\zeta} \sin qx.  \tag{2}

A body with the top :math:`z = h(x, y)` carries normal forces :math:`f`, along z for each projected
area. The complementary energy is the largest value of (3); by the fields of the flat body,
continued beyond its top [1]_, [2]_, its first order in :math:`h` is (4):

.. math:: 2 \int f\, u_z\, \mathrm{d}A - \int_{z < h} \sigma : \varepsilon\, \mathrm{d}V,   \tag{3}

.. math::
    f^t C_1 f = \int h \left(\sigma_{zz} \varepsilon_{zz}
        - \sigma_{\alpha\beta} \varepsilon_{\alpha\beta}\right) \mathrm{d}A.    \tag{4}

On a half-space :math:`\varepsilon_{\alpha\beta} = c\, \varphi_{,\alpha\beta}` with
:math:`c = (1 - 2\nu) / (2\mu)` and :math:`\Delta \varphi = f - \bar f`. For heights of zero mean,
integration by parts gives

.. math::
    C_1 f = c \left(\bar f\, h + \overline{h f}\right)
      + c\, (1 - 2\nu)\, \Delta^{-1} \operatorname{div} (H\, \nabla \Delta^{-1} f), \qquad
    H = \begin{pmatrix} h_{,yy} & -h_{,xy} \\ -h_{,xy} & h_{,xx} \end{pmatrix}.    \tag{5}

Two bodies of heights :math:`h_i`, each in a local frame with z out of it, touch at small slopes on

.. math::
    m = \frac{k_2 h_1 - k_1 h_2}{k_1 + k_2}, \qquad k_i = \frac{1 - \nu_i}{\mu_i},    \tag{6}

with forces along :math:`(-\nabla m, 1)`. Their motions :math:`c_i \nabla \Delta^{-1} f` in the
plane, and the compliance under forces in the plane, add to the sum of :math:`C_1` of the bodies

.. math::
    (c_1 - c_2) \left[\operatorname{div} \Delta^{-1} (f\, \nabla m)
      - \nabla m \cdot \nabla \Delta^{-1} f\right];    \tag{7}

equal bodies have half of :math:`C_1` of the composite heights on one body with the contact modulus
of both. (5) and (7) are derived here, and checked against conforming cells.

.. [1] O. P. Bruno and F. Reitich, J. Opt. Soc. Am. A 10 (1993) 1168-1175,
   doi:10.1364/JOSAA.10.001168.
.. [2] W. Craig and C. Sulem, J. Comput. Phys. 108 (1993) 73-83, doi:10.1006/jcph.1993.1164.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import fft

from multiscale.surfaces.surface import Surface

_DEEP = 24.0  # thickness times wavenumber above which a layer is a half-space to rounding


def layered_compliance(
    shape: tuple[int, int],
    size: tuple[float, float],
    planes: np.ndarray,
    lame: np.ndarray,
    shear: np.ndarray,
) -> np.ndarray:
    """Return the normal displacement under unit pressure, by wavenumber, m/Pa."""
    q_x = 2.0 * np.pi / size[0] * np.abs(np.fft.fftfreq(shape[0], 1.0 / shape[0]))
    q_y = 2.0 * np.pi / size[1] * np.arange(shape[1] // 2 + 1)
    modes = np.hypot(q_x[:, None], q_y)
    layers: list[list[float]] = []  # thickness and moduli, with equal neighbours joined
    for h, first, second in zip(np.diff(planes), lame, shear, strict=True):
        if layers and layers[-1][1:] == [first, second]:
            layers[-1][0] += h
        else:
            layers.append([h, first, second])
    # half-space for modes that do not reach below the upper layer
    h, first, second = layers[-1]
    shallow = h * modes < _DEEP
    with np.errstate(divide="ignore"):  # the mean is replaced
        compliance = (first + 2.0 * second) / (2.0 * second * (first + second)) / modes

    # other modes: stiffness of the layers, eliminated from the base up
    wavenumber, place = np.unique(modes[shallow], return_inverse=True)
    symbol = np.empty_like(wavenumber)
    symbol[0] = sum(h / (first + 2.0 * second) for h, first, second in layers)  # q = 0
    q = wavenumber[1:]
    below = np.full((q.size, 2, 2), np.inf)
    for h, first, second in layers:
        stiffness = _layer_stiffness(q, h, first, second)
        low, up = slice(0, 2), slice(2, 4)
        if np.isinf(below).all():  # the base is clamped
            below = stiffness[:, up, up]
        else:
            carried = np.linalg.solve(stiffness[:, low, low] + below, stiffness[:, low, up])
            below = stiffness[:, up, up] - stiffness[:, up, low] @ carried
    symbol[1:] = np.linalg.inv(below)[:, 1, 1]
    compliance[shallow] = symbol[place]
    return np.asarray(compliance)


def _layer_stiffness(q: np.ndarray, thickness: float, lame: float, shear: float) -> np.ndarray:
    """Stresses on the lower and upper face by (U, W) of both, shape (modes, 4, 4), Pa/m."""
    nu = 0.5 * lame / (lame + shear)
    kappa = 3.0 - 4.0 * nu
    depth = q * thickness
    motion, stress = np.zeros((2, q.size, 4, 4))
    for face, zeta in enumerate((np.zeros_like(q), depth)):
        for side, s in enumerate((1.0, -1.0)):
            # each pair of solutions starts from the face where it is largest
            distance = zeta - depth if s > 0.0 else zeta
            decay = np.exp(s * distance)
            for term in range(2):  # a and b of (1) and (2)
                column = 2 * side + term
                value = distance if term else np.ones_like(q)
                b = float(term)
                motion[:, 2 * face, column] = -(s * value + kappa * b) * decay
                motion[:, 2 * face + 1, column] = value * decay
                outward = (2.0 * face - 1.0) * 2.0 * shear * q * decay
                shear_stress = value + 2.0 * s * (1.0 - nu) * b
                stress[:, 2 * face, column] = -outward * shear_stress
                stress[:, 2 * face + 1, column] = outward * (s * value + (1.0 - 2.0 * nu) * b)
    return np.asarray(np.linalg.solve(motion.swapaxes(1, 2), stress.swapaxes(1, 2)).swapaxes(1, 2))


def expanded_compliance(
    surfaces: Sequence[Surface],
    symbol: np.ndarray,
    shear: Sequence[float],
    poissons_ratio: Sequence[float],
) -> Callable[..., np.ndarray]:
    r"""Return the symmetric :math:`C_0 + C_1` of two bodies: six transforms, two if flat."""
    (nx, ny), (dx, dy) = surfaces[0].heights.shape, surfaces[0].spacing
    h = np.stack([surface.heights - np.mean(surface.heights) for surface in surfaces])
    mu, nu = np.asarray(shear), np.asarray(poissons_ratio)
    c = (0.5 - nu) / mu
    first, second = (1.0 - nu) / mu
    middle = (second * h[0] - first * h[1]) / (first + second)  # (6)
    q_x, q_y = 2.0 * np.pi * np.fft.fftfreq(nx, dx)[:, None], 2.0 * np.pi * np.fft.rfftfreq(ny, dy)
    # derivatives; the derivative of the shortest wavelength vanishes on the grid
    by_x, by_y = (
        1j * np.where(np.abs(q) * step < 0.999 * np.pi, q, 0.0)
        for q, step in ((q_x, dx), (q_y, dy))
    )
    square = q_x**2 + q_y**2
    square[0, 0] = np.inf  # the mean has a separate term
    back_x, back_y = by_x / square, by_y / square  # of the inverse of minus the Laplacian

    def to_points(transform: np.ndarray) -> np.ndarray:
        return np.asarray(fft.irfft2(transform, s=(nx, ny), overwrite_x=True))

    # products with the heights and with the tilt of the contact surface
    area = dx * dy  # of a node, over which its force is distributed
    local = np.tensordot(c, h, 1) / area
    bent = fft.rfft2(np.tensordot(2.0 * c * (0.5 - nu), h, 1) / area)
    h_xx, h_yy, h_xy = (to_points(k * bent) for k in (by_x**2, by_y**2, by_x * by_y))
    tilt = fft.rfft2((c[0] - c[1]) * middle / area)
    tilt_x, tilt_y = to_points(by_x * tilt), to_points(by_y * tilt)

    def apply(force: np.ndarray, *, vertical: bool = False) -> np.ndarray:
        transform = fft.rfft2(force)
        along_x, along_y = to_points(back_x * transform), to_points(back_y * transform)
        moved = symbol * transform
        moved += back_x * fft.rfft2(h_yy * along_x - h_xy * along_y - tilt_x * force)  # (5), (7)
        moved += back_y * fft.rfft2(h_xx * along_y - h_xy * along_x - tilt_y * force)
        displacement = to_points(moved) + np.mean(force) * local + np.mean(local * force)
        if not vertical:
            displacement += tilt_x * along_x + tilt_y * along_y  # (7)
        return np.asarray(displacement)

    return apply

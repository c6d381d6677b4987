r"""Spheres that are pressed together by F and pulled sideways by T: partial slip.

Like bodies, so that the normal and the tangential problem do not act on each other; the two
functions for an elastic body on a rigid one state their assumptions. Ratios are :math:`T / \mu F`,
limits :math:`\mu F`, N, and a is the contact radius, m.
R. D. Mindlin, J. Appl. Mech. 16 (1949) 259-268; R. D. Mindlin and H. Deresiewicz, J. Appl. Mech. 20
(1953) 327-344; D. A. Spence, Proc. R. Soc. London A 305 (1968) 55-80 and J. Elast. 5 (1975)
297-319.
"""

import numpy as np
from scipy.optimize import brentq
from scipy.special import ellipk


def tangential_modulus(*bodies: tuple[float, float]) -> float:
    r"""Modulus of bodies (E, nu), :math:`1/G^* = \sum (2 - \nu_i)/G_i`, Pa."""
    return 1.0 / sum((2.0 - nu) * 2.0 * (1.0 + nu) / E for E, nu in bodies)


def stick_radius(ratio: np.ndarray | float) -> np.ndarray:
    r"""Radius of the stick zone over the contact radius, :math:`c/a = (1 - T/\mu F)^{1/3}`."""
    return np.asarray(np.maximum(0.0, 1.0 - np.asarray(ratio)) ** (1.0 / 3.0))


def tangential_displacement(
    ratio: np.ndarray | float, limit: float, radius: float, modulus: float
) -> np.ndarray:
    r"""Tangential displacement of distant points under a first load, m.

    .. math:: \delta_t = \frac{3 \mu F}{16\, a\, G^*} \left(1 - (1 - T/\mu F)^{2/3}\right).
    """
    left = np.maximum(0.0, 1.0 - np.asarray(ratio)) ** (2.0 / 3.0)
    return np.asarray(3.0 * limit / (16.0 * radius * modulus) * (1.0 - left))


def tangential_traction(
    distance: np.ndarray, ratio: float, friction: float, radius: float, peak: float
) -> np.ndarray:
    r"""Tangential traction under a first load, Pa; the second root in the stick zone only.

    .. math:: q = \mu p_0 \left(\sqrt{1 - r^2/a^2} - \tfrac{c}{a}\sqrt{1 - r^2/c^2}\right)
    """
    c = radius * float(stick_radius(ratio))
    whole = np.sqrt(np.maximum(0.0, 1.0 - np.square(distance) / radius**2))
    stuck = np.sqrt(np.maximum(0.0, c**2 - np.square(distance))) / radius
    return np.asarray(friction * peak * (whole - stuck))


def loop_energy(
    ratio: np.ndarray | float, limit: float, radius: float, modulus: float
) -> np.ndarray:
    r"""Energy dissipated in a cycle between :math:`\pm T`, J.

    .. math:: \Delta W = \frac{9 \mu^2 F^2}{10\, a\, G^*} \left(1 - (1 - \rho)^{5/3}
        - \frac{5\rho}{6}\bigl(1 + (1 - \rho)^{2/3}\bigr)\right), \qquad \rho = T/\mu F .
    """
    rho = np.asarray(ratio, dtype=float)
    left = 1.0 - rho
    share = 1.0 - left ** (5.0 / 3.0) - 5.0 * rho / 6.0 * (1.0 + left ** (2.0 / 3.0))
    return np.asarray(0.9 * limit**2 / (radius * modulus) * share)


def spence_stick_radius(friction: float, poissons_ratio: float) -> float:
    r"""Stick radius of an elastic body that is pressed on a rigid body, over the contact radius.

    The root :math:`c/a` of

    .. math:: \frac{a}{2c} \ln\frac{a + c}{a - c}
        = \frac{\mu}{\beta}\, K\!\left(\sqrt{1 - c^2/a^2}\right), \qquad
        \beta = \frac{1 - 2\nu}{2(1 - \nu)},

    with the complete elliptic integral :math:`K`. The effect of the shear on the pressure is left
    out, which :func:`tests.closed_forms.spence.punch_with_friction` keeps: at :math:`\nu = 0.3` the
    radius is then smaller by 11, 2.5 and 0.8 per cent for :math:`\mu = 0.1, 0.3, 0.5`.
    """
    beta = (1.0 - 2.0 * poissons_ratio) / (2.0 * (1.0 - poissons_ratio))

    def excess(k: float) -> float:
        return float(np.arctanh(k) / k - friction / beta * ellipk(1.0 - k**2))

    return float(brentq(excess, 1e-12, 1.0 - 1e-14))


def full_stick_load_ratio(poissons_ratio: float) -> float:
    r"""Force on a rigid flat punch that sticks, over that without friction at the same depth.

    .. math:: \frac{(1 - \nu) \ln(3 - 4\nu)}{1 - 2\nu}
    """
    nu = poissons_ratio
    return float((1.0 - nu) * np.log(3.0 - 4.0 * nu) / (1.0 - 2.0 * nu))

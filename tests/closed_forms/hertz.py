r"""Smooth bodies pressed together without friction: sphere, cylinder and flat punch.

Lengths in m, forces in N (N/m for the cylinder), pressures and contact moduli E* in Pa; the radius
of a contact of two spheres is :math:`1/R = \sum 1/R_i`. K. L. Johnson, Contact Mechanics, Cambridge
University Press, 1985, chapter 4.
"""

import numpy as np


def sphere_radius(force: float, radius: float, modulus: float) -> float:
    """Contact radius :math:`a = (3 F R / 4 E^*)^{1/3}`, m."""
    return float((0.75 * force * radius / modulus) ** (1.0 / 3.0))


def sphere_approach(force: float, radius: float, modulus: float) -> float:
    r"""Approach of distant points, :math:`\delta = a^2 / R`, m."""
    return sphere_radius(force, radius, modulus) ** 2 / radius


def sphere_stiffness(force: float, radius: float, modulus: float) -> float:
    r"""Stiffness in the normal direction, :math:`\mathrm{d}F/\mathrm{d}\delta = 2 E^* a`, N/m."""
    return 2.0 * modulus * sphere_radius(force, radius, modulus)


def sphere_pressure(
    distance: np.ndarray, force: float, radius: float, modulus: float
) -> np.ndarray:
    r"""Pressure at a distance r from the axis, :math:`3F/(2\pi a^2) \sqrt{1 - r^2/a^2}`, Pa."""
    a = sphere_radius(force, radius, modulus)
    peak = 1.5 * force / (np.pi * a**2)
    return np.asarray(peak * np.sqrt(np.maximum(0.0, 1.0 - np.square(distance) / a**2)))


def cylinder_half_width(force: float, radius: float, modulus: float) -> float:
    r"""Half-width of the contact of a cylinder, :math:`a = \sqrt{4 F R / (\pi E^*)}`, m."""
    return float(np.sqrt(4.0 * force * radius / (np.pi * modulus)))


def cylinder_pressure(
    distance: np.ndarray, force: float, radius: float, modulus: float
) -> np.ndarray:
    r"""Pressure :math:`p = p_0\sqrt{1 - x^2/a^2}` with :math:`p_0 = 2F/(\pi a)`, Pa."""
    a = cylinder_half_width(force, radius, modulus)
    peak = 2.0 * force / (np.pi * a)
    return np.asarray(peak * np.sqrt(np.maximum(0.0, 1.0 - np.square(distance) / a**2)))


def punch_force(approach: float, radius: float, modulus: float) -> float:
    r"""Force on a flat round punch of radius a, :math:`F = 2 E^* a \delta`, N."""
    return 2.0 * modulus * radius * approach


def punch_pressure(distance: np.ndarray, force: float, radius: float) -> np.ndarray:
    r"""Pressure under a flat round punch, :math:`p = F / (2\pi a \sqrt{a^2 - r^2})`, Pa."""
    inside = np.maximum(radius**2 - np.square(distance), 0.0)
    with np.errstate(divide="ignore"):
        return np.asarray(force / (2.0 * np.pi * radius * np.sqrt(inside)))

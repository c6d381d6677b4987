r"""Two rings, an inner and an outer ring, pressed from outside: frictionless contact.

Plane strain. The inner ring lies in :math:`a < r < b`, the outer ring in :math:`b < r < c`; the
outside carries the pressure :math:`p_0 + p_2 \cos 2\theta` and no shear, the inside nothing.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class NestedRings:
    r"""Exact solution from Michell's stress functions of orders 0 and 2.

    Radii :math:`a < b < c`, m, moduli of both rings, mean and wave :math:`p_0` and :math:`p_2`, Pa.
    In each ring

    .. math::
        \phi = A \ln r + B r^2 + (C r^2 + D r^4 + E r^{-2} + F)\cos 2\theta,    \tag{1}

    and the twelve constants follow from the tractions on the three circles and the continuity of
    :math:`u_r`. The rings stay closed as long as the contact pressure is positive.
    """

    radii: tuple[float, float, float]
    youngs_modulus: float
    poissons_ratio: float
    mean: float
    wave: float

    def contact_pressure(self, angle: np.ndarray) -> np.ndarray:
        """Pressure between the rings, Pa, at an angle from the x axis, rad."""
        b = self.radii[1]
        uniform, waving = self._constants()
        mean = _stress0(b) @ uniform[:2]
        wave = _stress2(b)[0] @ waving[:4]
        return np.asarray(-(mean + wave * np.cos(2.0 * np.asarray(angle))))

    def displacement(self, position: np.ndarray, outer: bool) -> np.ndarray:
        """Displacement of a ring at positions of shape (2, n), m."""
        r, angle = np.hypot(*position), np.arctan2(position[1], position[0])
        uniform, waving = self._constants()
        k = 1 if outer else 0
        radial = self._radial0(r) @ uniform[2 * k : 2 * k + 2]
        both = self._displacement2(r)
        constants = waving[4 * k : 4 * k + 4]
        radial = radial + both[0] @ constants * np.cos(2.0 * angle)
        hoop = both[1] @ constants * np.sin(2.0 * angle)
        cos, sin = np.cos(angle), np.sin(angle)
        return np.stack([radial * cos - hoop * sin, radial * sin + hoop * cos])

    def _constants(self) -> tuple[np.ndarray, np.ndarray]:
        """Constants (A, B) and (C, D, E, F) of the inner, then the outer ring."""
        a, b, c = self.radii
        none = np.zeros(2)
        uniform = np.array(
            [
                [*_stress0(a), *none],
                [*none, *_stress0(c)],
                [*_stress0(b), *-_stress0(b)],
                [*self._radial0(b), *-self._radial0(b)],
            ]
        )
        nil = np.zeros((2, 4))
        waving = np.vstack(
            [
                np.hstack([_stress2(a), nil]),
                np.hstack([nil, _stress2(c)]),
                np.hstack([_stress2(b)[:1], -_stress2(b)[:1]]),
                np.hstack([_stress2(b)[1:], nil[:1]]),
                np.hstack([nil[:1], _stress2(b)[1:]]),
                np.hstack([self._displacement2(b)[0], -self._displacement2(b)[0]])[None],
            ]
        )
        load0, load2 = np.zeros(4), np.zeros(8)
        load0[1], load2[2] = -self.mean, -self.wave
        return _solve(uniform, load0), _solve(waving, load2)

    def _moduli(self) -> tuple[float, float]:
        """Shear modulus and Kolosov's constant."""
        nu = self.poissons_ratio
        return self.youngs_modulus / (2.0 * (1.0 + nu)), 3.0 - 4.0 * nu

    def _radial0(self, r: np.ndarray | float) -> np.ndarray:
        """u_r of A ln r and B r^2, shape (..., 2)."""
        G, kappa = self._moduli()
        r = np.asarray(r)
        return np.stack([-1.0 / r, (kappa - 1.0) * r], axis=-1) / (2.0 * G)

    def _displacement2(self, r: np.ndarray | float) -> np.ndarray:
        """u_r / cos and u_theta / sin of the four terms, shape (2, ..., 4)."""
        G, kappa = self._moduli()
        r = np.asarray(r)
        radial = [-2.0 * r, (kappa - 3.0) * r**3, 2.0 / r**3, (kappa + 1.0) / r]
        hoop = [2.0 * r, (kappa + 3.0) * r**3, 2.0 / r**3, -(kappa - 1.0) / r]
        return np.stack([np.stack(radial, axis=-1), np.stack(hoop, axis=-1)]) / (2.0 * G)


def _stress0(r: float) -> np.ndarray:
    """sigma_rr of A ln r and B r^2."""
    return np.array([1.0 / r**2, 2.0])


def _stress2(r: float) -> np.ndarray:
    """sigma_rr / cos and sigma_rtheta / sin of r^2, r^4, r^-2 and 1, each times cos 2 theta."""
    normal = [-2.0, 0.0, -6.0 / r**4, -4.0 / r**2]
    shear = [2.0, 6.0 * r**2, -6.0 / r**4, -2.0 / r**2]
    return np.array([normal, shear])


def _solve(matrix: np.ndarray, load: np.ndarray) -> np.ndarray:
    """Solve with columns scaled: the powers of r differ by orders of magnitude."""
    scale = np.abs(matrix).max(axis=0)
    rows = np.abs(matrix / scale).max(axis=1)
    return np.asarray(np.linalg.solve(matrix / scale / rows[:, None], load / rows) / scale)

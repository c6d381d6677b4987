"""Statistics of the asperities of a surface, and the force of one elastic-plastic asperity."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.parameters import check_parameter
from multiscale.numerics.compiled import compiled, prange

__all__ = ["Asperities", "asperity_loads", "class_densities", "gaussian_asperities"]

NODES = 400
"""Approaches at which the ratio of plastic to elastic force is tabulated."""

REACH = 4.0
"""Heights of Gaussian asperities end at this multiple of their root mean square."""


@dataclass(frozen=True, eq=False)
class Asperities:
    r"""Spherical asperities between two alike bodies, in classes of equal height.

    Parameters
    ----------
    height : ndarray, shape (classes,), heights above the plane from which the gap counts, m
    density : ndarray, shape (classes,), asperities per area of each class, 1/m²
    radius : float, composite radius of both surfaces R, m
    youngs_modulus, poissons_ratio : float, Pa and dimensionless
    yield_stress : float, :math:`\sigma_y`, Pa; elastic if not given
    tangent_modulus : float, slope of the stress after yield :math:`E_t < E`, Pa

    Raises
    ------
    CaseError
        If a parameter is outside its range, or no class has asperities.

    Notes
    -----
    An asperity that is pressed by the approach d for the first time carries

    .. math:: F(d) = \varrho(d)\, \tfrac43 E^* \sqrt R\, d^{3/2},    \tag{1}

    with :math:`E^* = E / (2 (1 - \nu^2))`. The ratio :math:`\varrho` of the force to Hertz's
    force is 1 while the asperity is elastic; above about 1.9 of the approach at yield it follows
    from the flattening of a sphere with bilinear hardening [1]_, [2]_, from where this force falls
    below Hertz's, so that it is continuous, up to an approach of R, and stays constant beyond. An
    asperity that has been pressed by at most :math:`d_m` unloads, and loads again, as a flatter
    sphere [3]_, which meets (1) at :math:`d_m`,

    .. math::
        F = \tfrac43 E^* \sqrt{R / \varrho_m}\, \langle e\rangle_+^{3/2}, \qquad
        e = d - d_m (1 - \varrho_m), \qquad \varrho_m = \varrho(d_m).    \tag{2}

    References
    ----------
    .. [1] H. Ghaednia, M. R. W. Brake, M. Berryhill and R. L. Jackson, J. Tribol. 141 (2019)
       031402: hardening; eqs 25 and 26 are the contact radius here.
    .. [2] R. L. Jackson and I. Green, J. Tribol. 127 (2005) 343-354: the force without hardening.
    .. [3] M. R. W. Brake, Int. J. Solids Struct. 62 (2015) 104-123: unloading.
    """

    height: np.ndarray
    density: np.ndarray
    radius: float
    youngs_modulus: float
    poissons_ratio: float
    yield_stress: float = np.inf
    tangent_modulus: float = 0.0

    def __post_init__(self) -> None:
        z, n = np.asarray(self.height, dtype=float), np.asarray(self.density, dtype=float)
        if z.ndim != 1 or z.shape != n.shape or not np.all(np.isfinite(z)):
            raise CaseError(
                f"height (m) and density (1/m^2) of asperities must be finite lists of one length, "
                f"got shapes {z.shape} and {n.shape}"
            )
        if not (np.all(np.isfinite(n)) and np.all(n >= 0.0) and np.any(n > 0.0)):
            raise CaseError(
                f"the densities of asperities must not be negative (1/m^2), and one of them "
                f"positive, got {n.min(initial=0.0):g} to {n.max(initial=0.0):g}; give the density"
            )
        check_parameter(self, "radius", "m")
        check_parameter(self, "youngs_modulus", "Pa")
        if not 0.0 <= self.poissons_ratio <= 0.5:
            raise CaseError(f"poissons_ratio must be from 0 to 0.5, got {self.poissons_ratio:g}")
        if not self.yield_stress > 0.0:
            raise CaseError(f"yield_stress must be positive (Pa), got {self.yield_stress:g}")
        if not 0.0 <= self.tangent_modulus < self.youngs_modulus:
            raise CaseError(
                f"tangent_modulus must be from 0 to less than youngs_modulus (Pa), got "
                f"{self.tangent_modulus:g} and {self.youngs_modulus:g}"
            )
        kept = n > 0.0
        object.__setattr__(self, "height", np.ascontiguousarray(z[kept]))
        object.__setattr__(self, "density", np.ascontiguousarray(n[kept]))

    @property
    def contact_modulus(self) -> float:
        """Contact modulus E* of both bodies, Pa."""
        return 0.5 * self.youngs_modulus / (1.0 - self.poissons_ratio**2)

    @property
    def stiffness_ratio(self) -> float:
        """Tangential over normal stiffness of an asperity, by Mindlin."""
        return 2.0 * (1.0 - self.poissons_ratio) / (2.0 - self.poissons_ratio)

    @property
    def top(self) -> float:
        """Height of the highest asperities, m."""
        return float(self.height.max())

    @property
    def yield_approach(self) -> float:
        """Approach of an asperity at which it yields first, m; both spheres flatten by half."""
        return 4.0 * self.radius * self._yield_slope**2

    def ratio(self, approach: np.ndarray) -> np.ndarray:
        r"""Return the ratio :math:`\varrho` of plastic to elastic force at approaches d > 0, m."""
        spline, first, last = self._spline
        return np.where(approach > first, spline(np.log(np.clip(approach, first, last))), 1.0)

    @property
    def _yield_slope(self) -> float:
        """Root of half the approach at yield over the radius of one of the spheres."""
        C = 1.295 * np.exp(0.736 * self.poissons_ratio)
        return float(np.pi * C * self.yield_stress / (4.0 * self.contact_modulus))

    def _flattening(self, d: np.ndarray) -> np.ndarray:
        """Ratio of the force of a flattened sphere with hardening to the force of Hertz."""
        E, Et, sy, R = self.youngs_modulus, self.tangent_modulus, self.yield_stress, self.radius
        C = 1.295 * np.exp(0.736 * self.poissons_ratio)
        x = d / self.yield_approach
        elastic = np.sqrt(R * d)  # radii of the contact
        B = 0.14 * np.exp(23.0 * sy / (2.0 * self.contact_modulus))
        perfect = 2.0 * R * self._yield_slope * np.sqrt(x * (x / 1.9) ** B)
        grown = (Et / E) ** (1.0 - (d - self.yield_approach) / (4.0 * R))
        stiff = (4.0 - 3.0 * np.exp(-2.0 * np.sqrt(E / sy) * Et / E)) * (1.0 - Et / E)
        hardened = np.exp(-2.0 * np.sqrt(E / sy) * grown / stiff)
        a = elastic + (perfect - elastic) * hardened
        hardness = 2.84 - 0.92 * (1.0 - np.cos(0.5 * np.pi * a / R))  # over the yield stress
        share = 1.0 - np.exp(-(x ** (5.0 / 9.0)) / 25.0)
        # Hertz's force at yield times x^1.5 is the elastic force
        perfect = np.exp(-0.25 * x ** (5.0 / 12.0)) + 4.0 * hardness / C * share / np.sqrt(x)
        return np.asarray(perfect + (1.0 - perfect) * (1.0 - np.exp(-3.3 * Et / E)))

    @cached_property
    def _spline(self):  # type: ignore[no-untyped-def]
        """Spline of the ratio over the logarithm of the approach, and the ends of its range, m."""
        from scipy.interpolate import CubicSpline
        from scipy.optimize import brentq

        dy, R = self.yield_approach, self.radius
        if not 10.0 * dy < R:  # elastic up to approaches at which it is no sphere
            return CubicSpline([0.0, 1.0], [1.0, 1.0]), np.inf, np.inf
        first = brentq(lambda d: float(self._flattening(d)) - 1.0, 1e-3 * dy, 10.0 * dy)
        grid = np.linspace(np.log(first), np.log(R), NODES)
        value = self._flattening(np.exp(grid))
        value[0] = 1.0
        return CubicSpline(grid, value), first, R

    @property
    def table(self) -> tuple[np.ndarray, np.ndarray]:
        """Beginning and step of the logarithmic grid, and coefficients (4, nodes) of the ratio."""
        spline, first, _ = self._spline
        begin = np.log(first) if np.isfinite(first) else np.inf
        return np.array([begin, spline.x[1] - spline.x[0]]), np.ascontiguousarray(spline.c)


def class_densities(
    height: np.ndarray, weight: np.ndarray, density: float, classes: int = 101
) -> tuple[np.ndarray, np.ndarray]:
    """Divide a distribution of heights into classes.

    Parameters
    ----------
    height : ndarray, shape (n,), rising heights, m
    weight : ndarray, shape (n,), probability density at them, linear between them, in any unit
    density : float, asperities per area, 1/m²
    classes : int

    Returns
    -------
    height, density : ndarray, shape (classes,), m and 1/m²

    Raises
    ------
    CaseError
        If the heights do not rise, a weight is negative or all are zero.
    """
    z, w = np.asarray(height, dtype=float), np.asarray(weight, dtype=float)
    if z.ndim != 1 or z.shape != w.shape or z.size < 2 or not np.all(np.diff(z) > 0.0):
        raise CaseError(
            f"heights of asperities must rise and have one weight each, two or more, got "
            f"{z.size} heights and {w.size} weights"
        )
    if not (np.all(w >= 0.0) and np.any(w > 0.0) and np.all(np.isfinite(w))):
        raise CaseError("weights of heights must not be negative, nor all zero; give a density")
    at = np.linspace(z[0], z[-1], classes)
    share = np.interp(at, z, w)
    share[[0, -1]] *= 0.5
    return at, density * share / share.sum()


def gaussian_asperities(
    rms_height: float, density: float, classes: int = 101
) -> tuple[np.ndarray, np.ndarray]:
    """Heights about their mean plane, m, and densities, 1/m², of Gaussian asperities by classes."""
    z = np.linspace(-REACH, REACH, 20 * classes)
    return class_densities(rms_height * z, np.exp(-0.5 * z**2), density, classes)


@compiled(parallel=True)
def asperity_loads(gap, peak, yields, height, density, grid, ratios, hertz):  # type: ignore[no-untyped-def]
    """Load and stiffness of every class on its unloading curve, and their derivatives by the gap.

    Shape (4, classes, points); Pa and Pa/m. ``peak``, shape (points,), is the largest approach of
    the highest asperities so far, m; ``hertz`` is 4/3 E* sqrt(R). Without ``yields`` the curves of
    unloading (2) go on beyond the largest approach.
    """
    classes, points, top = height.size, gap.size, height.max()
    place = np.zeros((4, classes, points))
    for c in prange(points):
        loads = yields and top - gap[c] > peak[c]
        for i in range(classes):
            d = height[i] - gap[c]
            most = d if loads else max(peak[c] - (top - height[i]), 0.0)
            ratio, slope = 1.0, 0.0
            t = (np.log(most) - grid[0]) / grid[1] if most > 0.0 else -1.0
            if t >= ratios.shape[1]:
                x, j = grid[1], ratios.shape[1] - 1
                ratio = ratios[3, j] + x * (ratios[2, j] + x * (ratios[1, j] + x * ratios[0, j]))
            elif t > 0.0:
                j = int(t)
                x = (t - j) * grid[1]
                ratio = ratios[3, j] + x * (ratios[2, j] + x * (ratios[1, j] + x * ratios[0, j]))
                slope = ratios[2, j] + x * (2.0 * ratios[1, j] + x * 3.0 * ratios[0, j])
            e = d - most * (1.0 - ratio)
            if e <= 0.0:
                continue
            load = density[i] * hertz / np.sqrt(ratio) * e * np.sqrt(e)  # (2)
            stiffness = 1.5 * load / e
            place[0, i, c], place[1, i, c] = load, stiffness
            if loads:
                place[2, i, c] = -load / d * (1.5 + slope / ratio)
                place[3, i, c] = -0.5 * stiffness / d
            else:
                place[2, i, c], place[3, i, c] = -stiffness, -0.5 * stiffness / e
    return place

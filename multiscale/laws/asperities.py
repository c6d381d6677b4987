"""Law of an interface from the statistics of its asperities, elastic-plastic spheres."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from multiscale.errors import CaseError, ConvergenceError, require
from multiscale.laws.bulk.bulk_law import mindlin_ratio
from multiscale.laws.interface_law import Response, check_parameters
from multiscale.laws.sliders import SliderBed

NODES = 400  # approaches at which the ratio of plastic to elastic force is tabulated
REACH = 4.0  # heights of Gaussian asperities end at this multiple of their root mean square

MAX_ITERATIONS, TOLERANCE = 200, 1e-13
"""Iteration limit of the normal resolvent, and its residual relative to the largest term."""

AT_LIMIT = 1.0 - 1e-9  # share of the friction limit from which a class slips


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
                f"height (m) and density (1/m^2) of asperities must be finite lists of equal "
                f"length, got shapes {z.shape} and {n.shape}"
            )
        if not (np.all(np.isfinite(n)) and np.all(n >= 0.0) and np.any(n > 0.0)):
            raise CaseError(
                f"the densities of asperities must not be negative (1/m^2), nor all "
                f"zero, got {n.min(initial=0.0):g} to {n.max(initial=0.0):g}; give the density"
            )
        check_parameters(self, radius="m", youngs_modulus="Pa")
        require("poissons_ratio", self.poissons_ratio, "[0, 0.5]")
        require("yield_stress", self.yield_stress, "(0, inf]", "Pa")
        if not 0.0 <= self.tangent_modulus < self.youngs_modulus:
            raise CaseError(
                f"tangent_modulus must be from 0 to less than youngs_modulus (Pa), got "
                f"{self.tangent_modulus:g} and {self.youngs_modulus:g}"
            )
        object.__setattr__(self, "height", np.ascontiguousarray(z[n > 0.0]))
        object.__setattr__(self, "density", np.ascontiguousarray(n[n > 0.0]))

    @property
    def contact_modulus(self) -> float:
        """Contact modulus E* of both bodies, Pa."""
        return 0.5 * self.youngs_modulus / (1.0 - self.poissons_ratio**2)

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
        """Root of half the approach at yield over the radius of a sphere."""
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
        from scipy.interpolate import CubicSpline
        from scipy.optimize import brentq

        dy, R = self.yield_approach, self.radius
        if not 10.0 * dy < R:  # elastic up to approaches beyond the model of a sphere
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
    """Divide a density of heights, (n,), m, into classes: their heights, m, and densities, 1/m²."""
    z, w = np.asarray(height, dtype=float), np.asarray(weight, dtype=float)
    if z.ndim != 1 or z.shape != w.shape or z.size < 2 or not np.all(np.diff(z) > 0.0):
        raise CaseError(
            f"two or more heights of asperities must rise and have a weight each, got "
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


@dataclass(frozen=True, eq=False)
class AsperityLaw(SliderBed):
    r"""Greenwood-Williamson law with yield, loading history and friction of every height class.

    Parameters
    ----------
    asperities : Asperities, statistics and material
    friction : float, friction coefficient :math:`\mu \ge 0`, dimensionless
    stiffness_ratio : float, optional
        Tangential over normal stiffness :math:`\kappa`; :math:`2(1-\nu)/(2-\nu)` if not given.
    gap : float, initial gap between the planes from which heights count, m
    yields : bool, false once it is shaken down, see :meth:`shaken_down`

    Notes
    -----
    Classes i of height :math:`z_i` and :math:`n_i` asperities per area [1]_ carry

    .. math:: p = \sum_i N_i, \qquad N_i = n_i F(z_i - g),    \tag{1}

    with the force F of :class:`Asperities`, which depends on the smallest gap so far. Each class
    has a tangential spring, as stiff as :math:`\kappa` times the normal stiffness of the class on
    its unloading curve, :math:`w_i = n_i\, 2 E^* \sqrt{R_i e_i}`, and a slider with the limit
    :math:`\mu N_i` [2]_. Its step is (b) to (d) of :class:`Sliders`, with the mean stiffness of
    the step for m, so that no path gains energy; the force is a vector, where [2]_ has a slider
    for each direction.

    The state is the largest approach of the highest asperities, m, zero before the first loading,
    then force and stiffness of every spring and the last jump, as of :class:`Sliders`.

    References
    ----------
    .. [1] J. A. Greenwood and J. B. P. Williamson, Proc. R. Soc. A 295 (1966) 300-319,
       doi:10.1098/rspa.1966.0242.
    .. [2] J. H. Porter and M. R. W. Brake, Mech. Syst. Signal Process. 192 (2023) 110210: rough
       contact of the Brake-Reuss beam.

    Examples
    --------
    >>> alike = Asperities(np.array([0.0]), np.array([1e6]), 1e-3, 200e9, 0.3)  # elastic
    >>> law = AsperityLaw(alike, friction=0.1)
    >>> jump = np.array([[-1e-6], [1e-9], [0.0]])  # m
    >>> law.respond(jump, law.at_rest(jump * [[1.0], [0.0], [0.0]])).traction.ravel().round(-1)
    array([-4633370.,     5720.,        0.])
    """

    asperities: Asperities
    friction: float = 0.0
    stiffness_ratio: float | None = None
    gap: float = 0.0
    yields: bool = True

    def __post_init__(self) -> None:
        check_parameters(self, lowest=0.0, friction="1")
        if self.stiffness_ratio is not None:
            check_parameters(self, stiffness_ratio="1")

    @property
    def _layout(self) -> tuple[int, int, float]:
        kappa = self.stiffness_ratio or mindlin_ratio(self.asperities.poissons_ratio)
        return 1, self.asperities.height.size, kappa

    @cached_property
    def normal_law(self) -> "AsperityLaw":
        """Law of the gap only."""
        return replace(self, friction=0.0)

    def shaken_down(self) -> "AsperityLaw":
        """Return the law on the unloading curves of the asperities, for small motions."""
        return replace(self, yields=False)

    def _press(self, jump: np.ndarray, history: np.ndarray) -> tuple[Response, np.ndarray]:
        end, shape = self._springs(jump[0], history), jump.shape[1:]
        traction, tangent = np.zeros(jump.shape), np.zeros((len(jump), *jump.shape))
        traction[0] = -end[0].sum(axis=0).reshape(shape)  # (1)
        tangent[0, 0] = -end[2].sum(axis=0).reshape(shape)
        peak = history
        if self.yields:
            approach = self.asperities.top - (jump[:1] + self.gap)
            peak = np.maximum(history, np.maximum(approach, 0.0))
        return Response(traction, tangent, peak), end

    def _springs(self, jump: np.ndarray, history: np.ndarray) -> np.ndarray:
        """Load, stiffness and derivatives of the classes, shape (4, classes, points)."""
        from multiscale.laws.slabs import asperity_loads

        spheres = self.asperities
        return np.asarray(
            asperity_loads(
                np.ascontiguousarray(jump + self.gap, dtype=float).reshape(-1),
                np.ascontiguousarray(history[0], dtype=float).reshape(-1),
                self.yields,
                spheres.height,
                spheres.density,
                *spheres.table,
                float(4.0 / 3.0 * spheres.contact_modulus * np.sqrt(spheres.radius)),  # N m^-3/2
            )
        )

    def _resolve_normal(self, source: np.ndarray, k: np.ndarray, history: np.ndarray) -> np.ndarray:
        """Solve the normal row by Newton's method between b/k, as p >= 0, and first contact."""
        free: np.ndarray = source / k
        b, k, low = source[0], k[0], free[0]
        high = np.maximum(low, self.asperities.top - self.gap)
        jump = np.asarray(high)
        for _ in range(MAX_ITERATIONS):
            loads = self._springs(jump, history).sum(axis=1).reshape(4, *jump.shape)
            t = -loads[0]
            f = t + k * jump - b
            scale = np.maximum(np.maximum(np.abs(t), np.abs(b)), k * np.abs(jump))
            low, high = np.where(f <= 0.0, jump, low), np.where(f >= 0.0, jump, high)
            tight = high - low <= 4.0 * np.finfo(float).eps * (np.abs(low) + np.abs(high))
            if np.all((np.abs(f) <= TOLERANCE * scale) | tight):
                free[0] = jump
                return free
            step = jump - f / (k - loads[2])
            jump = np.where((step > low) & (step < high), step, 0.5 * (low + high))
        raise ConvergenceError(
            f"no normal jump solves the resolvent of AsperityLaw (relative residual "
            f"{float(np.max(np.abs(f) / scale)):.1e}); check that the source is finite (Pa)"
        )

    def slipping_load(self, jump: np.ndarray, state: np.ndarray) -> np.ndarray:
        """Share of the pressure of classes at their friction limit; see :class:`InterfaceLaw`."""
        if not self.friction:
            return super().slipping_load(jump, state)
        new = self.respond(jump, state).state
        N = self._springs(jump[0], new[:1])[0].reshape(-1, *jump.shape[1:])
        force = self._layout[2] * np.hypot(*np.split(new[1:-3], 3)[:2])
        slips = np.sum(np.where(force >= AT_LIMIT * self.friction * N, N, 0.0), axis=0)
        p = N.sum(axis=0)
        return np.asarray(np.where(p > 0.0, slips / np.where(p > 0.0, p, 1.0), 1.0))

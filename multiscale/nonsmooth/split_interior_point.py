r"""Primal-dual interior point for Coulomb friction, with the normal apart from the cone."""

from dataclasses import dataclass

import numpy as np

from multiscale.nonsmooth.block_system import factorise_blocks
from multiscale.nonsmooth.friction_problem import ScaledFriction
from multiscale.nonsmooth.lorentz import (
    apply,
    axis,
    divide,
    jordan_product,
    longest_positive,
    longest_step,
    lorentz_problem,
    nesterov_todd,
    spin,
    stalled,
)
from multiscale.nonsmooth.progress import Progress
from multiscale.numerics.factorisation import Solve

__all__ = ["split_interior_point"]

REGULARISATION = 1e-12
"""Added to the diagonal of W, relative to it, in the tangent matrix alone."""


def split_interior_point(
    problem: ScaledFriction, progress: Progress, max_iterations: int = 60, centre: float = 1.0
) -> np.ndarray:
    r"""Follow a central path of a friction problem that never meets the kink of ‖u_T‖.

    Notes
    -----
    With the sliding speed as an unknown :math:`s` of its own, Coulomb's law is a complementarity
    of numbers and one of cones. For :math:`z = (\mu r_N, r_T)`, :math:`g = u_N / \mu` and
    :math:`y = (s, u_T)`,

    .. math::
        W z + q - (g, y_T) = 0, \qquad z_0\, g = \sigma m, \qquad z \circ y = \sigma m\, e.
        \tag{1}

    With :math:`F` of Nesterov and Todd, d the defect of the first equation, and right-hand sides h
    of the numbers and k of the cones, :math:`F \Delta z + F^{-1} \Delta y = k`, a Newton step is

    .. math::
        \Bigl(W + \begin{bmatrix} g / z_0 & 0 \\ (F^2)_{T0} & (F^2)_{TT} \end{bmatrix}\Bigr)
        \Delta z = \begin{bmatrix} h / z_0 \\ (F k)_T \end{bmatrix} - d, \quad
        \Delta y = F k - F^2 \Delta z, \quad \Delta g = \frac{h - g \Delta z_0}{z_0},
        \tag{2}

    No term is smoothed, as s replaces the norm.
    """
    lorentz, unit = lorentz_problem(problem)
    contacts = len(unit)
    point = _Point(centre * axis(contacts), axis(contacts), np.ones(contacts))
    means: list[float] = []
    for _ in range(max_iterations):
        newton = _newton(lorentz, point)
        means.append(point.mean)
        if newton is None or stalled(means):
            break
        change, step = newton.step()
        if not step > 1e-6:
            break
        point = point.moved(change, step)
        if progress.note(unit * point.z):
            break
    return np.asarray(unit * point.z)


Change = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class _Point:
    """Point of the path."""

    z: np.ndarray
    y: np.ndarray
    g: np.ndarray

    @property
    def inside(self) -> bool:
        """Whether the point is inside its cones by more than round-off."""
        return bool(np.all(spin(self.z) > 0.0) and np.all(spin(self.y) > 0.0) and self.mean > 1e-16)

    @property
    def mean(self) -> float:
        """Mean product m of a pair."""
        total = np.sum(self.z * self.y) + np.sum(self.z[:, 0] * self.g)
        return 0.5 * float(total) / len(self.z)

    def moved(self, change: Change, step: float) -> "_Point":
        """Point a step ahead."""
        dz, dy, dg = change
        return _Point(self.z + step * dz, self.y + step * dy, self.g + step * dg)


@dataclass(frozen=True)
class _Newton:
    """Equation (2) at a point."""

    point: _Point
    scaling: tuple[np.ndarray, np.ndarray, np.ndarray]
    defect: np.ndarray
    solve: Solve

    def direction(self, k: np.ndarray, h: np.ndarray) -> Change:
        """Solve (2) for the changes of z, y and g."""
        F, _, F2 = self.scaling
        z0 = self.point.z[:, 0]
        Fk = apply(F, k)
        right = Fk - self.defect
        right[:, 0] = h / z0 - self.defect[:, 0]
        dz = self.solve(right)
        dy = Fk - apply(F2, dz)
        return dz, dy, (h - self.point.g * dz[:, 0]) / z0  # (2)

    def length(self, change: Change) -> float:
        """Step that stops short of the boundary."""
        dz, dy, dg = change
        limits = (
            longest_step(self.point.z, dz),
            longest_step(self.point.y, dy),
            longest_positive(self.point.z[:, 0], dz[:, 0]),
            longest_positive(self.point.g, dg),
        )
        return min(1.0, 0.99 * min(limits))

    def step(self) -> tuple[Change, float]:
        """Change by Mehrotra's predictor and corrector, and the length of the step."""
        point, mean = self.point, self.point.mean
        F, inverse, _ = self.scaling
        scaled = apply(F, point.z)
        squared, product = jordan_product(scaled, scaled), point.z[:, 0] * point.g
        change = self.direction(-scaled, -product)  # predictor
        if not np.all(np.isfinite(change[0])):
            return change, 0.0
        left = point.moved(change, self.length(change)).mean
        sigma = min(1.0, max((left / mean) ** 3, 1e-6)) if left > 0.0 else 1e-3

        e = axis(len(product))
        dz, dy, dg = change
        second = jordan_product(apply(F, dz), apply(inverse, dy))
        centred = max(sigma, 0.5) * mean
        for k, h in (
            (sigma * mean * e - squared - second, sigma * mean - product - dz[:, 0] * dg),
            (centred * e - squared, centred - product),
        ):
            change = self.direction(divide(scaled, k), h)
            if not np.all(np.isfinite(change[0])):
                return change, 0.0
            length = self.length(change)
            if length >= 0.1:
                break  # otherwise once more, towards the centre
        return change, length


def _newton(lorentz: ScaledFriction, point: _Point) -> _Newton | None:
    """Linearise (1) and factorise the matrix of (2); None where that fails."""
    if not point.inside:
        return None
    defect = lorentz.respond(point.z) - np.column_stack([point.g, point.y[:, 1:]])
    scaling = nesterov_todd(point.z, point.y)
    added = scaling[2].copy()
    added[:, 0] = 0.0
    added[:, 0, 0] = point.g / point.z[:, 0]
    added += REGULARISATION * np.eye(3)
    if not np.all(np.isfinite(added)):
        return None
    solve = factorise_blocks(lorentz, added)
    return None if solve is None else _Newton(point, scaling, defect, solve)

"""Primal-dual interior point for Coulomb friction, on cones with their axis in column 0."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from multiscale.nonsmooth.friction_problem import Progress, ScaledFriction, factorise_blocks
from multiscale.nonsmooth.lcp_methods import LONGEST, longest_positive

REGULARISATION = 1e-12  # added to the diagonal of W, relative to it, in the tangent matrix only
PATIENCE = 25  # steps in which the mean product has to fall by a tenth

SMALLEST_MEAN, SHORTEST_STEP = 1e-16, 1e-6
"""Mean product that is round-off, and length of a step at which the path ends."""

REFLECTION = np.diag([1.0, -1.0, -1.0])

Point = tuple[np.ndarray, np.ndarray, np.ndarray]  # unknowns z, y and g, or their changes

Linearised = tuple[Point, np.ndarray, Callable[[np.ndarray, np.ndarray], Point]]


def friction_interior_point(
    problem: ScaledFriction, progress: Progress, max_iterations: int = 60, centre: float = 1.0
) -> None:
    """Follow the central path (1) of a friction problem, with the sliding speed s as an unknown."""
    # With z = (mu r_N, r_T), g = u_N / mu, y = (s, u_T) and the cone product z∘y,
    #     W z + q - (g, y_T) = 0,   z_0 g = sigma m,   z∘y = sigma m e.  (1)
    lorentz, unit = lorentz_problem(problem)
    e = axis(len(unit))
    point, means = (centre * e, e, np.ones(len(unit))), list[float]()
    for _ in range(max_iterations):
        means.append(mean_product(point))
        if len(means) > PATIENCE and means[-1] > 0.9 * means[-1 - PATIENCE]:
            break
        newton = newton_step(lorentz, point)
        if newton is None or not newton[1] > SHORTEST_STEP:
            break
        point = _moved(point, *newton)
        if progress.note(unit * point[0]):
            break


def mean_product(point: Point) -> float:
    """Mean product m of a pair."""
    z, y, g = point
    return 0.5 * (float(np.sum(z * y)) + float(np.sum(z[:, 0] * g))) / len(z)


def _moved(point: Point, change: Point, step: float) -> Point:
    z, y, g = (old + step * by for old, by in zip(point, change, strict=True))
    return z, y, g


def _length(point: Point, change: Point) -> float:
    """Step that stops short of the boundary."""
    (z, y, g), (dz, dy, dg) = point, change
    limits = (
        longest_step(z, dz),
        longest_step(y, dy),
        longest_positive(z[:, 0], dz[:, 0]),
        longest_positive(g, dg),
    )
    return min(1.0, 0.99 * min(limits))


def linearise_cones(lorentz: ScaledFriction, point: Point) -> Linearised | None:
    """Scaling, defect and solution of (2) for right-hand sides k and h."""
    z, y, g = point
    within = np.all(spin(z) > 0.0) and np.all(spin(y) > 0.0)
    if not (within and mean_product(point) > SMALLEST_MEAN):
        return None
    # With F of Nesterov and Todd and the defect d,
    #     (W + [g/z_0, 0; (F²)_T0, (F²)_TT]) dz = (h/z_0, (F k)_T) - d,
    #     dy = F k - F² dz,   dg = (h - g dz_0) / z_0.  (2)
    F, inverse, F2 = nesterov_todd(z, y)
    added = F2.copy()
    added[:, 0] = 0.0
    added[:, 0, 0] = g / z[:, 0]
    added += REGULARISATION * np.eye(3)
    solve = factorise_blocks(lorentz, added) if np.all(np.isfinite(added)) else None
    if solve is None:
        return None
    defect = lorentz.respond(z) - np.column_stack([g, y[:, 1:]])

    def direction(k: np.ndarray, h: np.ndarray) -> Point:
        Fk = apply(F, k)
        right = Fk - defect
        right[:, 0] = h / z[:, 0] - defect[:, 0]
        dz = solve(right)
        return dz, Fk - apply(F2, dz), (h - g * dz[:, 0]) / z[:, 0]  # (2)

    return (F, inverse, F2), defect, direction


def newton_step(lorentz: ScaledFriction, point: Point) -> tuple[Point, float] | None:
    """Change by Mehrotra's predictor and corrector, and the length of the step."""
    linear = linearise_cones(lorentz, point)
    if linear is None:
        return None
    ((F, inverse, _), _, direction), (z, _, g), mean = linear, point, mean_product(point)
    # predictor: no centring
    scaled, product = apply(F, z), z[:, 0] * g
    squared = jordan_product(scaled, scaled)
    dz, dy, dg = change = direction(-scaled, -product)
    if not np.all(np.isfinite(dz)):
        return None
    left = mean_product(_moved(point, change, _length(point, change)))
    sigma = min(1.0, max((left / mean) ** 3, 1e-6)) if left > 0.0 else 1e-3

    # corrector with second-order terms; towards the centre if its step is short
    e, centred = axis(len(z)), max(sigma, 0.5) * mean
    second = jordan_product(apply(F, dz), apply(inverse, dy))
    length = 0.0
    for k, h in (
        (sigma * mean * e - squared - second, sigma * mean - product - dz[:, 0] * dg),
        (centred * e - squared, centred - product),
    ):
        change = direction(divide(scaled, k), h)
        if not np.all(np.isfinite(change[0])):
            return None
        length = _length(point, change)
        if length >= 0.1:
            break
    return change, length


def lorentz_problem(problem: ScaledFriction) -> tuple[ScaledFriction, np.ndarray]:
    r"""Write a friction problem in the coordinates of the cone."""
    stretch = np.ones((problem.friction.size, 3))
    stretch[:, 0] /= problem.friction
    rows = np.repeat(np.arange(len(stretch)), np.diff(problem.starts))
    blocks = problem.blocks * stretch[rows][:, :, None] * stretch[problem.columns][:, None, :]
    mobility = float(np.mean(np.abs(np.einsum("iaa->ia", blocks[problem.diagonal]))))
    velocity = problem.velocity * stretch
    speed = float(np.max(np.abs(velocity)))
    scaled = replace(problem, blocks=blocks / mobility, velocity=velocity / speed)
    return scaled, stretch * speed / mobility


def apply(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Matrix times vector at every contact."""
    return np.asarray(np.einsum("iab,ib->ia", matrices, vectors))


def axis(contacts: int) -> np.ndarray:
    """Return the unit of the Jordan product, (1, 0, 0) at every contact."""
    e = np.zeros((contacts, 3))
    e[:, 0] = 1.0
    return e


def spin(x: np.ndarray) -> np.ndarray:
    """Product of the two eigenvalues, x_0² - ‖x_T‖²: positive inside the cone."""
    return np.asarray(x[:, 0] ** 2 - x[:, 1] ** 2 - x[:, 2] ** 2)


def jordan_product(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    r"""Jordan product :math:`x \circ y = (x^T y,\ x_0 y_T + y_0 x_T)`."""
    out: np.ndarray = x[:, :1] * y + y[:, :1] * x
    out[:, 0] = np.sum(x * y, axis=1)
    return out


def divide(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    r"""Solution z of :math:`x \circ z = y`."""
    out = np.empty_like(y)
    out[:, 0] = (x[:, 0] * y[:, 0] - x[:, 1] * y[:, 1] - x[:, 2] * y[:, 2]) / spin(x)
    out[:, 1:] = (y[:, 1:] - out[:, :1] * x[:, 1:]) / x[:, :1]
    return out


def longest_step(x: np.ndarray, direction: np.ndarray) -> float:
    """Longest step along a direction for which all points stay inside their cones."""
    a = spin(direction)
    b = x[:, 0] * direction[:, 0] - np.sum(x[:, 1:] * direction[:, 1:], axis=1)
    c = np.maximum(spin(x), 0.0)
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    with np.errstate(all="ignore"):
        # smallest positive root of a t² + 2 b t + c, without cancellation
        q = -(b + np.where(b >= 0.0, root, -root))
        roots = np.stack([q / a, c / q])
    real = (b * b >= a * c) & (roots > 0.0)
    return min(
        float(np.min(np.where(real, roots, np.inf), initial=LONGEST)),
        longest_positive(x[:, 0], direction[:, 0]),
    )


def nesterov_todd(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Scaling matrices of Nesterov and Todd."""
    size_x, size_y = spin(x), spin(y)
    xbar, ybar = x / np.sqrt(size_x)[:, None], y / np.sqrt(size_y)[:, None]
    gamma = np.sqrt(0.5 * (1.0 + np.sum(xbar * ybar, axis=1)))
    w = (ybar + xbar @ REFLECTION) / (2.0 * gamma)[:, None]
    v = (w + axis(len(w))) / np.sqrt(2.0 * (w[:, 0] + 1.0))[:, None]
    eta = np.sqrt(np.sqrt(size_y / size_x))[:, None, None]
    mirrored = v @ REFLECTION
    return (
        eta * (2.0 * v[:, :, None] * v[:, None, :] - REFLECTION),
        (2.0 * mirrored[:, :, None] * mirrored[:, None, :] - REFLECTION) / eta,
        eta**2 * (2.0 * w[:, :, None] * w[:, None, :] - REFLECTION),
    )

r"""Algebra of the second-order cone :math:`\{x : \|x_T\| \le x_0\}`, contact by contact.

Every function takes arrays of shape (contacts, 3) with the axis of the cone in column 0.
"""

from dataclasses import replace

import numpy as np

from multiscale.nonsmooth.friction_problem import ScaledFriction

__all__ = [
    "apply",
    "axis",
    "divide",
    "jordan_product",
    "longest_positive",
    "longest_step",
    "lorentz_problem",
    "nesterov_todd",
    "spin",
    "stalled",
]

PATIENCE = 25
"""Steps in which an interior point has to lower the mean product by a tenth."""

LONGEST = 1e10
"""A step that nothing limits."""

REFLECTION = np.diag([1.0, -1.0, -1.0])


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


def stalled(means: list[float]) -> bool:
    """Whether the mean product of an interior point has stopped falling."""
    return len(means) > PATIENCE and means[-1] > 0.9 * means[-1 - PATIENCE]


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
    """Largest step along a direction that every point of the cone's inside can make."""
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


def longest_positive(x: np.ndarray, direction: np.ndarray) -> float:
    """Largest step along a direction that keeps positive numbers positive."""
    falling = direction < 0.0
    return float(np.min(-x[falling] / direction[falling], initial=LONGEST))


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

r"""Posterior of whitened parameters: its mode, its covariance and weighted draws.

Residuals are over the deviations of the data, with Student's distribution of :math:`\nu` degrees of
freedom to the power :math:`\nu / (\nu + 1)`, so that no value has more than its stated weight:

.. math:: |\theta|^2 + \nu \sum_i \ln (1 + r_i^2 / \nu).    \tag{1}
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

FREEDOM = 4.0
"""Degrees of freedom of the data, nu in (1)."""

PROPOSAL = 7.0  # degrees of freedom of the draws

MOST_STEPS = 60
MOST_DAMPING = 1e6  # over the diagonal of the Hessian, above which steps vanish in noise

NEAR, SETTLED = 0.1, 1e-3
"""Distances from the mode in posterior standard deviations of each parameter: of the squares, of
answers with noise, and at kinks, as where a curve of stiffness is bent to rise; elsewhere."""

Residual = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Maps parameters to residuals (data,) and their derivatives (data, parameters)."""


class Mode(NamedTuple):
    """Mode of a posterior, and its normal approximation."""

    theta: np.ndarray  # (parameters,)
    covariance: np.ndarray  # (parameters, parameters)
    residual: np.ndarray  # (data,)
    derivative: np.ndarray  # (data, parameters), of the residual
    weight: np.ndarray  # (data,), of the squares of the residuals, at most 1
    solves: int
    apart: float  # distance from the mode in posterior standard deviations, over sqrt(n)

    @property
    def settled(self) -> bool:
        """Whether the distance from the mode is small."""
        return self.apart <= NEAR

    @property
    def cautions(self) -> list[str]:
        """Caution against a larger distance, of data with kinks."""
        if self.apart <= SETTLED:
            return []
        return [
            f"the parameters of the law converged to {self.apart:.1g} of their posterior standard "
            f"deviations in {self.solves} solves instead of {SETTLED:g}, since the answers have "
            f"kinks or noise; their intervals may have errors of this size"
        ]

    @property
    def learned(self) -> np.ndarray:
        """Share of the prior variance of every parameter that the data remove."""
        return np.asarray(1.0 - np.diag(self.covariance))

    @property
    def pull(self) -> np.ndarray:
        """Standard deviations by which the data move every parameter."""
        spread = np.sqrt(np.maximum(self.learned, 1e-12))
        return np.where(self.learned > 1e-6, self.theta / spread, 0.0)


def find_mode(residual: Residual, n: int, *, noisy: bool = False) -> Mode:
    """Minimise (1) by Gauss-Newton steps with Levenberg's damping; squares first, then Student.

    With noisy answers steps end where a step fails within NEAR of the mode, or all damped steps do.
    """
    theta, solves = np.zeros(n), 1
    r, J = residual(theta)
    for robust in (False, True):
        value, damping = _objective(theta, r, robust), 0.0
        for _ in range(MOST_STEPS):
            H, gradient, apart = _newton(theta, r, J, robust)
            if apart <= (SETTLED if robust else NEAR):
                break
            step = -np.linalg.solve(H + damping * np.diag(np.diag(H)), gradient)
            r_new, J_new = residual(theta + step)
            solves += 1
            new = _objective(theta + step, r_new, robust)
            if np.isfinite(new) and new <= value + 1e-9 * abs(value):
                theta, r, J, value = theta + step, r_new, J_new, new
                damping = 0.0 if damping < 1e-3 else 0.1 * damping
            else:
                damping = max(10.0 * damping, 1e-2)
                if noisy and (apart <= NEAR or damping > MOST_DAMPING):
                    break
    H, _, apart = _newton(theta, r, J, robust=True)
    return Mode(theta, np.linalg.inv(H), r, J, _weights(r), solves, apart)


def _newton(
    theta: np.ndarray, r: np.ndarray, J: np.ndarray, robust: bool
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return Hessian and gradient of (1), or of the squares, and the length of a step by them."""
    weight = _weights(r) if robust else np.ones(r.size)
    H = np.eye(theta.size) + J.T @ (weight[:, None] * J)
    gradient = theta + J.T @ (weight * r)
    # without damping, the length is small near a mode only
    return H, gradient, float(np.sqrt(gradient @ np.linalg.solve(H, gradient) / theta.size))


def _weights(r: np.ndarray) -> np.ndarray:
    """Return the weights of the squares that give the gradient of (1)."""
    return np.asarray(FREEDOM / (FREEDOM + r**2))


def _objective(theta: np.ndarray, r: np.ndarray, robust: bool) -> float:
    """Evaluate (1), or the sum of the squares."""
    data = FREEDOM * np.log1p(r**2 / FREEDOM) if robust else r**2
    return float(theta @ theta + np.sum(data))


class Draws(NamedTuple):
    """Draws of a posterior with equal weights."""

    theta: np.ndarray  # (samples, parameters)
    effective: float  # number of independent draws with the same variance, at most the samples
    tail: float  # shape of the Pareto tail of the weights; above .7 the weights are unreliable


def draw(
    residual: Residual, mode: Mode, candidates: int, samples: int, random: np.random.Generator
) -> Draws:
    """Draw from Student's distribution about the mode, and resample by smoothed weights."""
    n = mode.theta.size
    factor = np.linalg.cholesky(mode.covariance)
    y = random.normal(size=(candidates, n))
    y /= np.sqrt(random.chisquare(PROPOSAL, candidates) / PROPOSAL)[:, None]
    theta = mode.theta + y @ factor.T
    log_weight = 0.5 * (PROPOSAL + n) * np.log1p(np.sum(y**2, axis=1) / PROPOSAL)
    log_weight -= [0.5 * _objective(at, residual(at)[0], True) for at in theta]
    log_weight, tail = smooth_weights(np.where(np.isfinite(log_weight), log_weight, -np.inf))
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    # systematic resampling: a draw occurs as often as expected, up or down to a whole number
    level = (np.arange(samples) + random.uniform()) / samples
    chosen = np.searchsorted(np.cumsum(weight), level).clip(max=candidates - 1)
    effective = min(float(1.0 / np.sum(weight**2)), float(samples))
    return Draws(theta[random.permutation(chosen)], effective, tail)


def smooth_weights(log_weight: np.ndarray) -> tuple[np.ndarray, float]:
    """Replace the largest log weights by quantiles of a Pareto tail; return its shape, too."""
    log_weight = log_weight - log_weight.max()
    n = log_weight.size
    m = int(min(0.2 * n, 3.0 * np.sqrt(n)))
    order = np.argsort(log_weight)
    tail, cut = order[-m:], np.exp(log_weight[order[-m - 1]])
    if cut == 0.0:  # a few draws have all of the weight
        return log_weight, np.inf
    excess = np.exp(log_weight[tail]) - cut
    if m < 5 or not excess.min() > 0.0:
        return log_weight, -np.inf
    # A. Vehtari et al., J. Mach. Learn. Res. 25 (2024) 72; J. Zhang, M. A. Stephens, Technometrics
    # 51 (2009) 316-325
    # profile likelihood of the scale on a grid, averaged
    count = 30 + int(np.sqrt(m))
    b = (1.0 - np.sqrt(count / (np.arange(count) + 0.5))) / (3.0 * excess[int(m / 4 + 0.5) - 1])
    b += 1.0 / excess[-1]
    shape = np.mean(np.log1p(-b[:, None] * excess), axis=1)
    likelihood = m * (np.log(-b / shape) - shape - 1.0)
    share = 1.0 / np.sum(np.exp(likelihood - likelihood[:, None]), axis=1)
    b_mean = float(b @ share)
    k = float(np.mean(np.log1p(-b_mean * excess)))
    scale = -k / b_mean
    k = (m * k + 5.0) / (m + 10.0)  # a weak prior of the shape
    p = (np.arange(m) + 0.5) / m
    quantile = scale * np.expm1(-k * np.log1p(-p)) / k
    smooth = log_weight.copy()
    smooth[tail] = np.minimum(np.log(quantile + cut), 0.0)
    return smooth, k

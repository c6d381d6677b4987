"""Means over few expensive and many cheap realisations, and their bootstrap."""

from dataclasses import dataclass
from typing import Self

import numpy as np

FEWEST_REALISATIONS = 3
"""Least number of realisations for samples: with fewer, the interval of a mean is too wide."""

CERTAIN = 1.6448536269514722  # standard deviations to 95 % of one side

FEWEST_PAIRS = 4  # below, Fisher's transformation has no finite deviation

HIGHEST = 1.0 - 1e-12  # correlation, of which the transformation is finite

SMALLEST = 1e-12  # sum of squares about the mean over the sum of squares, without scatter below


def draw_counts(
    n_realisations: int, n_samples: int, seed: int, *, n_further: int = 0
) -> np.ndarray:
    """Draw multiplicities of each realisation, and of ``n_further`` others, (samples, all)."""
    if n_realisations < FEWEST_REALISATIONS:
        return np.empty((0, n_realisations + n_further))
    drawn = [
        np.random.default_rng(stream).multinomial(n, np.full(n, 1.0 / n), size=n_samples)
        for n, stream in ((n_realisations, seed), (n_further, [seed, 1]))
        if n
    ]
    return np.hstack(drawn).astype(float)


def student(freedom: np.ndarray | int, probability: float = 0.975) -> np.ndarray:
    """Return quantiles of Student's distribution, of at least one degree of freedom."""
    from scipy.special import stdtrit  # of scipy.stats, which takes half a second to load

    return np.asarray(stdtrit(np.maximum(freedom, 1), probability))


def widening(freedom: int, confidence: float = 0.95, *, n: int | None = None) -> float:
    """Return the factor from the width of a percentile interval of few data to Student's."""
    from scipy.special import ndtri

    # sqrt(N / (N-1)) t / z (1); the root if n = N is given: the variance of a bootstrap has the
    # divisor N
    tail = 0.5 * (1.0 + confidence)
    factor = float(student(freedom, tail) / ndtri(tail))
    return factor if n is None else float(np.sqrt(n / max(n - 1.0, 1.0))) * factor


def most_confident(n_realisations: int) -> float:
    """Return the largest confidence of an interval of percentiles of resampled realisations."""
    # the rarest of the extreme samples draws a realisation N times: (1 - c) / 2 >= N^-N
    return 1.0 - 2.0 * float(n_realisations) ** -n_realisations


def half_range(samples: np.ndarray) -> np.ndarray:
    """Return the half-width of the 95 % percentile interval of samples, along the first axis."""
    return np.asarray(0.5 * np.ptp(np.nanpercentile(samples, [2.5, 97.5], axis=0), axis=0))


@dataclass(frozen=True, eq=False)
class Control:
    r"""A mean over few expensive and many cheap values, as two independent means [1]_, [2]_.

    With the values :math:`y_i` of R expensive and :math:`f_i` of M cheap cells, the first R of them
    on the surfaces of the others, and :math:`r_i = y_i - \bar y_R - \alpha (f_i - \bar f_R)`,

    .. math::
        \hat y = \bar y_R + \alpha\, (\bar f_M - \bar f_R), \qquad
        \alpha = \frac{\sum_i (f_i - \bar f_R)(y_i - \bar y_R)}{\sum_i (f_i - \bar f_R)^2},
        \tag{1}

    .. math::
        \operatorname{var} \hat y \approx \frac{1}{R (R - 2)} \sum_i r_i^2
        \left[1 + R\, \frac{(\bar f_M - \bar f_R)^2}{\sum_i (f_i - \bar f_R)^2}\right]
        + \frac{\alpha^2}{M (M - 1)} \sum_j (f_j - \bar f_M)^2.    \tag{2}

    .. [1] M. B. Giles, Acta Numerica 24 (2015) 259-328, doi:10.1017/S096249291500001X.
    .. [2] B. Peherstorfer, K. Willcox and M. Gunzburger, SIAM Review 60 (2018) 550-591,
       doi:10.1137/16M1082469.
    """

    mean: np.ndarray  # (points,)
    weight: np.ndarray  # alpha
    correlation: np.ndarray  # observed
    residuals: np.ndarray  # (R, points), scaled: their variance gives the first term of (2)
    cheap: np.ndarray  # (M, points), alpha times the distance from the mean; NaN if not counted

    @classmethod
    def of(cls, dear: np.ndarray, cheap: np.ndarray) -> Self | None:
        """Combine the values of both ensembles; None if they follow each other by chance only."""
        paired = np.isfinite(dear) & np.isfinite(cheap[: len(dear)])
        n = paired.sum(axis=0)
        if n.min() < FEWEST_PAIRS:
            return None
        y, f = (np.where(paired, values, np.nan) for values in (dear, cheap[: len(dear)]))
        # weight of the control, and the distance of both means of the cheap values
        f_pairs, f_all = np.nanmean(f, axis=0), np.nanmean(cheap, axis=0)
        dy, df = y - np.nanmean(y, axis=0), f - f_pairs
        square = np.nansum(df**2, axis=0)
        steady = square <= SMALLEST * np.nansum(f**2, axis=0)  # without scatter, no control
        weight = np.where(steady, 0.0, np.nansum(df * dy, axis=0) / np.where(steady, 1.0, square))
        far = np.where(steady, 0.0, (f_all - f_pairs) ** 2 / np.where(steady, 1.0, square))
        scale = np.sqrt((1.0 + n * far) * (n - 1) / np.maximum(n - 2, 1))
        total = np.nansum(dy**2, axis=0)
        correlation = weight * np.sqrt(square / np.where(total > 0.0, total, 1.0))
        # with 95 %, in the median over the points; to take the narrower interval would make it too
        # narrow
        # Fisher's test of the correlation
        bounded = np.clip(correlation, -HIGHEST, HIGHEST)
        if np.median(np.arctanh(bounded) * np.sqrt(n - 3)) < CERTAIN:
            return None
        return cls(
            np.nanmean(y, axis=0) + weight * (f_all - f_pairs),
            weight,
            correlation,
            scale * (dy - weight * df),
            weight * (cheap - f_all),
        )

    def __str__(self) -> str:
        """Return the number of cheap cells, and their correlation with the expensive cells."""
        low, high = self.correlation.min(), self.correlation.max()
        counted = int(np.isfinite(self.cheap).any(axis=1).sum())
        return f"{counted} control cells with a correlation of {low:.5g} to {high:.5g}"

    def at(self, points: slice | np.ndarray) -> Self:
        """Return the mean of some of the points."""
        fields = (self.mean, self.weight, self.correlation, self.residuals, self.cheap)
        return type(self)(*(values[..., points] for values in fields))

    @property
    def ensembles(self) -> tuple[tuple[np.ndarray, int], ...]:
        """Values about the mean, of both independent ensembles, and the freedom of each."""
        pairs, cheap = len(self.residuals), len(self.cheap)
        return (self.mean + self.residuals, pairs - 2), (self.mean + self.cheap, cheap - 1)

    def means(self, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return means of samples, spread as Student's, and their weights, (samples, points)."""
        pairs, n = len(self.residuals), len(self.cheap)
        ends = (counts[:, :pairs], self.residuals, pairs - 2), (counts, self.cheap, n - 1)
        mean = np.tile(self.mean, (len(counts), 1))
        for drawn, rows, freedom in ends:
            total = drawn @ np.isfinite(rows)
            moved = drawn @ np.nan_to_num(rows) / np.maximum(total, 1.0)
            mean += widening(freedom, n=len(rows)) * moved
        counted = np.isfinite(self.residuals)
        return mean, counts[:, :pairs] @ counted / counted.sum(axis=0)


def best_ratio(correlation: float, cost_ratio: float) -> float:
    """Return the best ratio of cheap cells, M/R = sqrt(c rho² / (1 - rho²)), (3.6) of [2]_."""
    square = min(correlation**2, 1.0 - 1e-6)
    return float(np.sqrt(cost_ratio * square / (1.0 - square)))

"""Samples of an ensemble: whole realisations drawn with replacement, spread as by Student."""

import numpy as np

__all__ = ["FEWEST_REALISATIONS", "draw_counts", "half_range", "most_confident", "widening"]

FEWEST_REALISATIONS = 3
"""Below, the interval of a mean is too wide to be of use and there are no samples."""


def draw_counts(
    n_realisations: int, n_samples: int, seed: int, *, n_further: int = 0
) -> np.ndarray:
    """How often each realisation occurs in each sample, shape (samples, realisations + further).

    The ``n_further`` members of a second ensemble are drawn independently of the realisations.
    """
    if n_realisations < FEWEST_REALISATIONS:
        return np.empty((0, n_realisations + n_further))
    drawn = [
        np.random.default_rng(stream).multinomial(n, np.full(n, 1.0 / n), size=n_samples)
        for n, stream in ((n_realisations, seed), (n_further, [seed, 1]))
        if n
    ]
    return np.hstack(drawn).astype(float)


def widening(freedom: int, confidence: float = 0.95, *, n: int | None = None) -> float:
    r"""Factor that gives a percentile interval of few data the width of Student's.

    .. math:: \sqrt{N/(N-1)}\; t_{(1+c)/2,\,\nu} / z_{(1+c)/2}    \tag{1}

    for :math:`\nu` degrees of freedom and the confidence c; the root only if n, the number N of
    independent data whose variance the bootstrap takes with divisor N, is given.
    """
    from scipy.special import ndtri, stdtrit  # of scipy.stats, which takes half a second to load

    tail = 0.5 * (1.0 + confidence)
    factor = float(stdtrit(max(freedom, 1), tail) / ndtri(tail))
    return factor if n is None else float(np.sqrt(n / max(n - 1.0, 1.0))) * factor


def most_confident(n_realisations: int) -> float:
    r"""Largest confidence of an interval between percentiles of resampled realisations.

    The rarest of the extreme samples draws one realisation N times, with probability
    :math:`N^{-N}`; a tail of less than that has no percentile, so that
    :math:`(1-c)/2 \ge N^{-N}`.
    """
    return 1.0 - 2.0 * float(n_realisations) ** -n_realisations


def half_range(samples: np.ndarray) -> np.ndarray:
    """Half-width of the 95 % interval between percentiles of samples, along their first axis."""
    return np.asarray(0.5 * np.ptp(np.nanpercentile(samples, [2.5, 97.5], axis=0), axis=0))

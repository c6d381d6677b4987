"""Closed cycles of a load: their factors, their steps and their work."""

import numpy as np

__all__ = ["closed_cycle", "cycle_work", "find_cycles", "to_and_fro"]


def to_and_fro(steps: int, cycles: int) -> np.ndarray:
    """Rise to 1 in some steps, then closed cycles to -1 and back."""
    rise = np.arange(1, steps + 1) / steps
    return np.concatenate([rise, np.tile(closed_cycle(steps), cycles)])


def find_cycles(first: int, steps: int, cycles: int) -> list[slice]:
    """Find the steps of each cycle, with both ends, after a rise that begins at one of them."""
    start = first + steps - 1 + 4 * steps * np.arange(cycles)
    return [slice(at, at + 4 * steps + 1) for at in start]


def closed_cycle(steps: int) -> np.ndarray:
    """Shear over its amplitude from the positive amplitude to the negative one and back.

    Parameters
    ----------
    steps : int, load steps from zero to the amplitude

    Returns
    -------
    ndarray, shape (4 steps,), the start, at the positive amplitude, is left out
    """
    rise = np.arange(1, steps + 1) / steps
    return np.concatenate([1.0 - rise, -rise, rise - 1.0, rise])


def cycle_work(amplitude: np.ndarray | float, displacement: np.ndarray) -> np.ndarray:
    r"""Work of a closed cycle of shear.

    Parameters
    ----------
    amplitude : float or ndarray, shape (...), amplitude of the shear, Pa
    displacement : ndarray, shape (..., 4 steps + 1)
        Displacement along the shear at the positive amplitude and in the steps of
        :func:`closed_cycle`, m.

    Returns
    -------
    ndarray, shape (...)
        With the displacement q and the shear :math:`\tau`, J/m²:

        .. math:: \oint \tau\, \mathrm{d}q = \tau_a (q_{end} - q_{start})
            - \oint q\, \mathrm{d}\tau    \tag{1}

        by Simpson's rule on both branches, which is exact where slip grows as the square of the
        shear from the last reversal, as it does while it is small.
    """
    half = displacement.shape[-1] // 2
    weight = np.ones(half + 1)
    weight[1:-1:2], weight[2:-1:2] = 4.0, 2.0
    back, forth = displacement[..., : half + 1], displacement[..., half:]
    enclosed = 2.0 / (3.0 * half) * np.asarray(amplitude) * ((back - forth) @ weight)
    return np.asarray(amplitude * (displacement[..., -1] - displacement[..., 0]) + enclosed)

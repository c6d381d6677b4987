r"""Control variates against plain ensembles of the same time, and the coverage of their bands.

Small cells of three kinds are pressed on the same surfaces as flat elastic cells: conforming cells
(gap, contact fraction, stiffness) and cells with friction that are sheared a little (tangential
stiffness); flat cells with a hardness are pressed on two grids (gap of a metal). Estimates of few
of them and of many flat cells are drawn 200 times from these pools, each without repetition. The
truth is the estimate of the whole pool, so that errors are smaller than errors of new cells by
about the root of one less the share that is drawn, in both ensembles alike. Small cells replace
large cells but not their times: a flat cell is taken to cost a fiftieth, as compared with
conforming cells of 128 x 128 points.
"""

import logging
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import t

from multiscale.micro import Cell, Path, solve_cell
from multiscale.pipeline.stages.ensembles import COST
from multiscale.upscaling.sampling import Control, best_ratio
from tests.support import rough_square

MODULUS, NU, SLOPE, EDGE, POINTS = 1e9, 0.3, 0.05, 1e-3, 24
E_STAR = MODULUS / (1.0 - NU**2)
PRESSURE = E_STAR * SLOPE * np.array([0.02, 0.05, 0.1, 0.2])
FRICTION, HARDNESS = 0.3, 0.6
DEAR, SHEARED, CHEAP = 64, 32, 800
REPEATS, DRAWN, PLAIN, MOST = 200, 6, 12, 25


def press(k, points=POINTS, **options):
    """Gap and contact fraction of a cell, (2, pressures)."""
    surface = rough_square(points, EDGE / 2, EDGE / 4, SLOPE, seed=k, size=EDGE)
    cell = Cell(surface, EDGE, 4, MODULUS, NU, **options)
    response = solve_cell(cell, Path(pressure=tuple(PRESSURE)), tolerance=1e-3)
    return np.array([response[name].values[0] for name in ("mean_gap", "contact_fraction")])


def shear(k):
    """Tangential stiffness of a cell with friction, sheared a little, (pressures - 1,)."""
    surface = rough_square(POINTS, EDGE / 2, EDGE / 4, SLOPE, seed=k, size=EDGE)
    cell = Cell(surface, EDGE, 4, MODULUS, NU, friction_coefficient=FRICTION)
    pressure = PRESSURE[1:]
    ways = np.cumsum(0.005 * FRICTION * pressure * EDGE / E_STAR)
    slide = np.ravel([np.append(0.0, ways[:-1]), ways], order="F")
    path = Path(
        pressure=tuple(np.repeat(pressure, 2)), slide=tuple((float(cells), 0.0) for cells in slide)
    )
    response = solve_cell(cell, path, tolerance=1e-6)
    jump, traction = (
        np.diff(response[name].values[0, :, 1])[::2] for name in ("displacement_jump", "traction")
    )
    return traction / jump


def stiffness(gap):
    """Pressure over the change of the gap between pressures, (cells, pressures - 1)."""
    return -np.diff(PRESSURE) / np.diff(gap, axis=1)


@dataclass(frozen=True)
class Pool:
    """Values of dear cells and of flat cells, of which the first have their surfaces."""

    dear: np.ndarray
    cheap: np.ndarray

    @property
    def truth(self):
        """Mean by all cells."""
        return Control.of(self.dear, self.cheap).mean

    def draw(self, random, n, ratio):
        """Some dear cells, their flat cells and further cells."""
        mine = random.permutation(len(self.dear))[:n]
        rest = np.arange(len(self.dear), len(self.cheap))
        further = random.permutation(rest)[: max(0, round(ratio * n) - n)]
        return self.dear[mine], self.cheap[[*mine, *further]]


@pytest.fixture(scope="module")
def pools():
    """All kinds of cells on the same surfaces."""

    def pressed(count, **options):
        return np.swapaxes([press(k, **options) for k in range(count)], 0, 1)

    flat, conforming = pressed(CHEAP, geometry="flat"), pressed(DEAR)
    hard = {"geometry": "flat", "hardness": HARDNESS * E_STAR * SLOPE}
    coarse, fine = pressed(CHEAP, **hard), pressed(DEAR, points=2 * POINTS, **hard)
    sheared = np.array([shear(k) for k in range(SHEARED)])
    near = stiffness(flat[0])
    return {
        "gap": Pool(conforming[0], flat[0]),
        "contact fraction": Pool(conforming[1], flat[1]),
        "stiffness": Pool(stiffness(conforming[0]), near),
        "tangential stiffness": Pool(sheared, near),
        "gap of a metal": Pool(fine[0], coarse[0]),
    }


def interval(dear, cheap):
    """Mean and half-width by both ensembles, or only by the dear cells."""
    estimate = Control.of(dear, cheap)
    parts = ((dear, len(dear) - 1),) if estimate is None else estimate.ensembles
    mean = dear.mean(axis=0) if estimate is None else estimate.mean
    halves = [
        t.ppf(0.975, free) * rows.std(axis=0, ddof=1) / len(rows) ** 0.5 for rows, free in parts
    ]
    return mean, np.linalg.norm(halves, axis=0)


@pytest.mark.slow
def test_few_dear_cells_and_many_flat_cells_err_less_for_the_time_and_their_bands_cover(pools):
    for name, pool in pools.items():
        random, truth = np.random.default_rng(seed=0), pool.truth
        correlation = float(np.median(Control.of(pool.dear, pool.cheap).correlation))
        ratio = min(best_ratio(correlation, COST), MOST)  # of the pool, not all of it
        drawn = max(4, round(PLAIN / (1.0 + ratio / COST)))
        plain, with_control, inside = [], [], []
        for _ in range(REPEATS):
            dear, _ = pool.draw(random, PLAIN, 1.0)
            plain.append(dear.mean(axis=0) / truth - 1.0)
            mean, _ = interval(*pool.draw(random, drawn, ratio))
            with_control.append(mean / truth - 1.0)
            mean, half = interval(*pool.draw(random, DRAWN, ratio))
            inside.append(np.abs(mean - truth) <= half)
        error, less = (np.sqrt(np.mean(np.square(item))) for item in (plain, with_control))
        logging.getLogger(__name__).warning(
            "| %s | %.4f | %d + %d | %.2f | %.2f | %.1f | %.1f |",
            *(name, correlation, drawn, round(ratio * drawn)),
            *(100.0 * error, 100.0 * less, error / less, 100.0 * np.mean(inside)),
        )
        assert 0.92 <= np.mean(inside) <= 1.0, name
        assert less < error, name

"""A rough structure solved in three ways: with a law, with cells at every point, and resolved.

*Sequential*: cells are pressed, a law is fitted, the structure is solved with it; *law at hand* is
this solve only. *Concurrent*: a cell is solved wherever the structure asks for a pressure.
*Direct*: all roughness is in the model of the structure. The scenes are a wave that is rough and a
joint of two blocks under a tilted platen; the longest wave of the roughness is 1/4 to 1/32 of them.

    python workflows/three_ways.py -o three_ways [--quick]

leaves the dataset ``work_precision.nc`` and its figure, error of the mean gap against run time of
one answer. It takes a quarter of an hour; ``--quick`` takes one ratio, coarse grids, few surfaces.

The truth of a structure with its own surface is resolved on the finest grid and extrapolated; the
bound of what is left is the uncertainty. ``error`` is the root mean square over the structures, as
a law or a cell does not know the surface at hand; ``mean_error`` is the error of their mean.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from multiscale.io import make_folder, write_dataset
from multiscale.plotting import draw_work_precision
from multiscale.schema import WORK_PRECISION
from multiscale.studies import (
    RoughStructure,
    RoughWave,
    TiltedJoint,
    solve_concurrent,
    solve_direct,
    solve_sequential,
)
from multiscale.upscaling import estimate_grid_error

SCENES = {"rough wave": RoughWave, "joint of two blocks": TiltedJoint}
EFFORTS = ((1 / 4, 8, 16), (1 / 8, 6, 16), (1 / 16, 4, 8), (1 / 32, 3, 8))
"""Ratios, structures, points per shortest wave of the truth: 4 times a power of 2."""


def measure(
    structure: RoughStructure, seeds: range, finest: int, cells: int, points: int
) -> Iterator[dict[str, object]]:
    """Answer in all ways, and judge the answers by the truth; a row for each."""
    grids = [4 * 2**k for k in range(int(np.log2(finest / 4)) + 1)]
    direct = {n: solve_direct(structure, seeds, points_per_wave=n) for n in grids}
    coarser = {finest / n: direct[n].gaps for n in grids[:-1]}
    estimate = estimate_grid_error(direct[finest].gaps, coarser)
    truth = direct[finest].gaps - estimate.error
    law = solve_sequential(structure, range(cells), points_per_wave=points)
    concurrent = solve_concurrent(structure, seeds, points_per_wave=points)
    ways = [("sequential", law, law.seconds), ("sequential, law at hand", law, law.solve_seconds)]
    ways += [("concurrent", concurrent, concurrent.seconds / len(seeds))]
    ways += [(f"direct, {n} points per wave", direct[n], direct[n].seconds) for n in grids[:-1]]
    for method, way, seconds in ways:
        off = way.gaps - truth
        yield {
            "method": method,
            "scale_ratio": structure.ratio,
            "realisations": len(seeds),
            "wall_time": seconds / (len(seeds) if method.startswith("direct") else 1),
            "error": np.sqrt(np.mean((off / truth) ** 2)),
            "error_uncertainty": np.sqrt(np.mean((estimate.half_width / truth) ** 2)),
            "mean_error": abs(np.mean(off) / np.mean(truth)),
            "mean_error_uncertainty": off.std(ddof=1) / np.sqrt(len(seeds)) / np.mean(truth),
            "cells_solved": way.solved / len(way.answers),
            "cells_reused": way.reused / len(way.answers),
            "converged": 1,
        }


def main(argv: Sequence[str] | None = None) -> int:
    """Measure all ways and draw them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("three_ways"))
    parser.add_argument("--quick", action="store_true", help="one ratio, few surfaces")
    arguments = parser.parse_args(argv)
    out, rows = make_folder(arguments.out), []
    for name, kind in SCENES.items():
        for way in (solve_sequential, solve_concurrent, solve_direct):  # imports, compilation
            way(kind(0.25), [0], points_per_wave=3)
        for ratio, count, finest in [(1 / 4, 2, 8)] if arguments.quick else EFFORTS:
            numbers = (2, 4) if arguments.quick else (8, 8)  # cells, points per wave
            for row in measure(kind(ratio), range(count), finest, *numbers):
                rows.append({"scene": name, **row})
                said = f"{name}, 1/{round(1 / ratio)}, {row['method']}: error {row['error']:.2%}"
                sys.stdout.write(f"{said}, {row['wall_time']:.3g} s\n")
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    found = WORK_PRECISION.build(columns, title="three ways to the mean gap of rough structures")
    write_dataset(found, out / "work_precision.nc", WORK_PRECISION)
    draw_work_precision(found, out / "work_precision.png")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

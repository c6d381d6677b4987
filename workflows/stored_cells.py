"""The cells that the planner starts from, solved for four self-affine spectra.

Cells of one, two and four longest waves on a coarse grid give the scatter and the bias by their
size, and the smallest cells on finer grids the error of the grid.

    python workflows/stored_cells.py -o multiscale/pipeline [--quick]

leaves ``stored_cells.nc``. It takes some minutes; ``--quick`` solves few cells of one spectrum.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from multiscale.io import make_folder, write_dataset
from multiscale.micro import Cell, run_ensemble, self_affine
from multiscale.micro import Path as LoadPath
from multiscale.schema import STORED_CELLS

SPECTRA = tuple((hurst, band) for hurst in (0.5, 0.8) for band in (4, 8))
KINDS = {(1, 4): 48, (2, 4): 32, (4, 4): 16, (1, 8): 12, (1, 16): 12}  # cells by waves and points
LOADS = np.geomspace(0.005, 0.5, 9)
MODULUS, NU, SLOPE, WAVE = 1e9, 0.3, 0.1, 1e-3


def main(argv: Sequence[str] | None = None) -> int:
    """Solve the cells and write them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("stored_cells"))
    parser.add_argument("--quick", action="store_true", help="few cells of one spectrum")
    arguments = parser.parse_args(argv)
    rows: dict[str, list[np.ndarray]] = {}
    for hurst, band in SPECTRA[:1] if arguments.quick else SPECTRA:
        for (waves, points), count in KINDS.items():
            found = _solve(hurst, band, waves, points, 2 if arguments.quick else count)
            for name, value in found.items():
                rows.setdefault(name, []).append(value)
            sys.stdout.write(f"H {hurst}, band {band}: {waves} waves, {points} points\n")
    values = {name: np.concatenate(row) for name, row in rows.items()}
    dataset = STORED_CELLS.build(values | {"relative_pressure": LOADS})
    write_dataset(dataset, make_folder(arguments.out) / "stored_cells.nc", STORED_CELLS)
    return 0


def _solve(hurst: float, band: int, waves: int, points: int, count: int) -> dict[str, np.ndarray]:
    """Cells of one kind; those on several grids are the same."""
    n, edge = waves * band * points, waves * WAVE
    spectrum = {"hurst_exponent": hurst, "long_cutoff": WAVE, "short_cutoff": WAVE / band}
    cells = [
        Cell(
            self_affine((n, n), (edge, edge), 1000 * waves + k, rms_slope=SLOPE, **spectrum),
            edge,
            8,
            MODULUS,
            NU,
            geometry="flat",
        )
        for k in range(count)
    ]
    pressures = MODULUS / (1.0 - NU**2) * SLOPE * LOADS
    response = run_ensemble(cells, LoadPath(pressure=tuple(pressures)))
    height = response["rms_height"].to_numpy()[:, None]
    described = {"waves": waves, "points": points, "hurst_exponent": hurst, "band": band}
    return {name: np.full(count, float(value)) for name, value in described.items()} | {
        "gap_over_height": response["mean_gap"].to_numpy() / height,
        "contact_fraction": response["contact_fraction"].to_numpy(),
        "wall_time": response["wall_time"].to_numpy(),
    }


if __name__ == "__main__":
    sys.exit(main())

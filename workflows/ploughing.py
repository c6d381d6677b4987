"""Slide two rough bodies over each other: friction against pressure and sliding distance.

A hard elastic surface ploughs soft steel. Both are deformable, at large strain, with
a local friction coefficient at each point of contact; the rest of the resistance is ploughing, the
work of plastic flow. The first pass flattens the soft summits, so later passes plough less.

    python workflows/ploughing.py -o ploughing [--quick]

writes the dataset ``sliding_response.nc`` and its figure ``friction.png`` in about twenty
minutes; ``--quick`` takes a coarse grid, one pressure and a short distance.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from multiscale.io import make_folder, write_dataset
from multiscale.laws.bulk import J2, NeoHookean
from multiscale.micro import Cell, SecondBody, Surface, self_affine, slide_cell
from multiscale.plotting import plot_lines
from multiscale.plotting.figure import on_axes
from multiscale.schema import SLIDING_RESPONSE

SIZE = 50e-6  # m
MODULUS, POISSON = 210e9, 0.3  # Pa
LOCAL_FRICTION = 0.1


def rough(points: int, seed: int, slope: float) -> Surface:
    """Return a self-affine surface with wavelengths from the cell size to a quarter of it."""
    return self_affine(
        (points, points),
        (SIZE, SIZE),
        seed,
        hurst_exponent=0.8,
        long_cutoff=SIZE,
        short_cutoff=SIZE / 4.0,
        rms_slope=slope,
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Slide, write and draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("ploughing"))
    parser.add_argument("--quick", action="store_true", help="coarse, one pressure, short distance")
    arguments = parser.parse_args(argv)
    out = make_folder(arguments.out)

    points, layers = (12, 4) if arguments.quick else (24, 8)
    cell = Cell(
        rough(points, 1, 0.1),
        SIZE,
        layers,
        MODULUS,
        POISSON,
        obstacle=rough(points, 2, 0.15),
        bulk=J2(MODULUS, POISSON, yield_stress=1.0e9, hardening_modulus=2e9),
        friction_coefficient=LOCAL_FRICTION,
        opposite=SecondBody(SIZE, layers, NeoHookean(MODULUS, POISSON)),
    )
    pressure = (0.3e9,) if arguments.quick else (0.1e9, 0.3e9, 0.6e9)
    response = slide_cell(
        cell,
        pressure,
        0.1 * SIZE if arguments.quick else 1.5 * SIZE,
        steps=2 if arguments.quick else 36,
        tolerance=1e-5,
    )
    write_dataset(response, out / "sliding_response.nc", SLIDING_RESPONSE)
    draw = on_axes(plot_lines, response, "effective_friction", by="nominal_pressure")
    draw(out / "friction.png")
    for load, friction in zip(pressure, response["effective_friction"].values, strict=True):
        sys.stdout.write(
            f"{1e-6 * load:.0f} MPa: friction {friction[1]:.3f} at first, {friction[-1]:.3f} at "
            f"the end, {LOCAL_FRICTION:g} at each point\n"
        )
    return int(not response["converged"].values.all())


if __name__ == "__main__":
    raise SystemExit(main())

"""A joint of two rough faces, calibrated by its measured stiffness and a shear loop.

Cells of the two faces give the law with its uncertainty. Stiffness at low preloads and a loop
correct it, with unknown frame and zero of the load; it predicts a loop at four times the load.

    python workflows/measured_joint.py -o calibrated [--tables STIFFNESS LOOP HELD_OUT] [--quick]

writes ``interface_law.nc`` and ``measured_joint.png``, the loop by cells and by the calibrated law;
without tables also the tables of a joint with rougher faces, friction .24, a frame and noise.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from multiscale import upscaling
from multiscale.io import make_folder, save_law
from multiscale.micro import Cell, run_ensemble, self_affine
from multiscale.micro import Path as Pressures
from multiscale.plotting.figure import save_figure
from multiscale.schema import Dataset

SPECTRUM = {"hurst_exponent": 0.8, "long_cutoff": 200e-6, "short_cutoff": 50e-6}
WAY = np.concatenate([np.linspace(0.1, 1, 10), np.linspace(0.8, -1, 10), np.linspace(-0.8, 1, 10)])
KINDS = ("stiffness", "loop", "loop")
SHOWN = {"1": (1.0, ""), "m/Pa": (1e12, " µm/MPa"), "Pa": (1e-6, " MPa")}


def main(argv: Sequence[str] | None = None) -> int:
    """Calibrate the law, and predict the loop that was left out."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("calibrated"))
    parser.add_argument("--tables", type=Path, nargs=3, help="with the columns of the tables here")
    parser.add_argument("--quick", action="store_true", help="coarser cells")
    arguments = parser.parse_args(argv)
    out, points = make_folder(arguments.out), 32 if arguments.quick else 64

    cells = upscaling.assume_shear(press(points), friction=0.3, stiffness_ratio=0.82)
    files = arguments.tables or write_tables(out, press(points, first=100, factor=1.1))
    *seen, validation = map(upscaling.read_measured, files, KINDS)
    calibration = upscaling.calibrate(cells, seen, cells=8.0)
    save_law(law := calibration.law, out / "interface_law.nc")
    for name, unit, _, before, value, after, learned, _ in calibration.parameters:
        scale, shown = SHOWN[unit]
        values = f"{scale * value:.3g} ± {scale * after:.2g}{shown}, before ± {scale * before:.2g}"
        sys.stdout.write(f"{name}: {values}{shown}, {learned:.0%} learned\n")
    value, ends = upscaling.predict_measured(law, validation)
    apart, noise = np.abs(value - validation.value), 1.96 * validation.deviation
    inside = np.mean(apart <= np.hypot(noise, np.abs(ends - value).min(axis=0)))
    share = f"{inside:.0%} of the held-out loop in its band"
    sys.stdout.write("\n".join([*calibration.sentences, share, ""]))
    ax, u = (
        Figure(figsize=(5.0, 3.6), layout="constrained").subplots(),
        1e6 * validation.displacement,
    )
    ax.plot(u, 1e-6 * upscaling.predict_measured(cells, validation)[0], "0.6", label="cells only")
    ax.errorbar(u, 1e-6 * value, 1e-6 * np.abs(ends - value), label="calibrated, 95 %")
    ax.plot(u, 1e-6 * validation.value, "C3x", label="held out")
    ax.set(xlabel="displacement (µm)", ylabel="shear (MPa)")
    ax.legend(title="loop under 80 MPa", fontsize="small")
    save_figure(ax.figure, out / "measured_joint.png")
    return 0


def press(points: int, first: int = 0, factor: float = 1.0) -> Dataset:
    """Press eight pairs of steel faces in flat cells, and fit their law."""
    grid, size = (points, points), (400e-6, 400e-6)  # m
    height, cells = factor * 0.4e-6, []
    for seed in range(first, first + 16, 2):
        lower, upper = (
            self_affine(grid, size, seed + k, rms_height=height, **SPECTRUM) for k in range(2)
        )
        cells.append(Cell(lower, 400e-6, 8, 105e9, 0.3, obstacle=upper, geometry="flat"))
    return upscaling.fit_law(run_ensemble(cells, Pressures(tuple(np.geomspace(2e6, 240e6, 10)))))


def write_tables(out: Path, law: Dataset) -> list[Path]:
    """Write values of a joint with the law of other cells: stiffness, and two loops."""
    random, files = np.random.default_rng(seed=1), [out / f"table_{k}.csv" for k in range(3)]
    law = upscaling.assume_shear(law, friction=0.24, stiffness_ratio=0.75)
    rows = [[f"{p:.4g}" for p in np.geomspace(5, 40, 8)]]
    rows += [[f"{p},{a * u:.4g}" for u in WAY] for p, a in ((20, 0.15), (80, 0.4))]
    heads = ["stiffness (MPa/um)"] + ["displacement (um),shear (MPa)"] * 2
    for file, head, given, kind in zip(files, heads, rows, KINDS, strict=True):
        values = np.arange(1.0, 1.0 + len(given))  # until the joint is measured
        for _ in range(2):
            lines = [f"{row},{x:.4g},3" for row, x in zip(given, values, strict=True)]
            file.write_text(
                "\n".join([f"preload (MPa),{head},error (%)", *lines, ""]), encoding="utf-8"
            )
            table = upscaling.read_measured(file, kind, bodies=2e-15)
            true = upscaling.predict_measured(law, table)[0]
            scale = true if kind == "stiffness" else np.abs(true).max()
            noisy = true + 0.015 * scale * random.normal(size=true.size)
            values = noisy / (1e12 if kind == "stiffness" else 1e6)
    return files


if __name__ == "__main__":
    raise SystemExit(main())

"""Fit the law of an interface to a table of measured stiffness, and test it on other specimens.

The table has the stiffness of an interface over its pressure, with units in its first line.
Without ``--csv`` the script writes a table: K = 3 (p/MPa)^0.6 MPa/um, specimens that scatter by
10 %, and 3 % of noise. The last quarter of the specimens is left out of the fit, for a test.

    python workflows/measured_stiffness.py -o measured [--csv FILE] [--quick]

leaves ``stiffness.csv``, ``law_comparison.nc``, ``interface_law.nc``, ``macro_result.nc`` of two
steel blocks, and ``measured_stiffness.png``: the law with its bands and all specimens, and the
joint with its band, which contains only the scatter. ``--quick`` takes few samples for the bands.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from multiscale import upscaling
from multiscale.io import make_folder, save_law, write_dataset
from multiscale.macro import Block, RoughJoint, press_joint
from multiscale.plotting import plot_joint_stiffness
from multiscale.plotting.figure import save_figure
from multiscale.schema import LAW_COMPARISON, MACRO_RESULT

PRELOADS = np.array([1e6, 3e6, 10e6, 30e6])  # Pa
BLOCK = Block(5e-3, 210e9, 0.3)  # of steel


def main(argv: Sequence[str] | None = None) -> int:
    """Fit the table, solve the joint, and draw both."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("measured"))
    parser.add_argument("--csv", type=Path, help='such as "pressure (MPa), stiffness (MPa/um)"')
    parser.add_argument("--quick", action="store_true", help="few samples for the bands")
    arguments = parser.parse_args(argv)
    out = make_folder(arguments.out)

    table, quantity = arguments.csv or write_table(out / "stiffness.csv"), "normal_stiffness"
    seen = upscaling.read_observations(table, quantity)
    n_fitted = seen.n_realisations - seen.n_realisations // 4
    known = upscaling.observe(quantity, seen.pressure, seen.values[:n_fitted])
    family, families = upscaling.best_family(known)
    law = upscaling.fit_law(known, family=family, n_samples=100 if arguments.quick else 1000)
    write_dataset(families, out / "law_comparison.nc", LAW_COMPARISON)
    save_law(law, out / "interface_law.nc")
    mean, *samples = upscaling.fitted_laws(law, [None, *range(law.sizes["sample"])])
    prediction = upscaling.predict(law, known, seen.pressure)
    middle, band, wide = prediction.value, prediction.mean_law, prediction.next_specimen
    joint = press_joint(RoughJoint((0.02, 0.02), BLOCK, BLOCK), mean, PRELOADS, samples=samples)
    if samples:
        ends = np.percentile(joint["joint_stiffness_sample"], (2.5, 97.5), axis=0)
        joint = MACRO_RESULT.assign(joint, {"joint_stiffness_mean_law": ends})
    write_dataset(joint, out / "macro_result.nc", MACRO_RESULT)
    factor = np.exp(np.nanmean(np.log(seen.values / middle), axis=1))[n_fitted:]
    low, high = (wide / middle)[:, 0]
    sys.stdout.write(
        f"error at unseen pressures:\n{families['cross_validated_error'].to_series().to_string()}\n"
        f"{family}, {n_fitted} specimens: the mean law within {_within(band, middle)}, the next "
        f"specimen within {_within(wide, middle)}; {np.sum((low <= factor) & (factor <= high))} of "
        f"{factor.size} specimens that were held out lie there\n"
        f"{''.join(f'{sentence}; ' for sentence in prediction.unknown)}joint: "
        f"{np.round(1e-12 * joint['joint_stiffness'].values, 2)} MPa/um at {1e-6 * PRELOADS} MPa\n"
    )
    left, right = Figure(figsize=(9.0, 3.6), layout="constrained").subplots(1, 2)
    plot_joint_stiffness(joint, ax=right)
    x = 1e-6 * seen.pressure
    left.fill_between(x, *(1e-12 * wide), color="C0", alpha=0.15, label="next specimen, 95 %")
    left.fill_between(x, *(1e-12 * band), color="C0", alpha=0.4, label="mean law, 95 %")
    left.loglog(x, 1e-12 * middle, color="C0", label=f"law, {family}")
    left.loglog(x, 1e-12 * seen.values[:n_fitted].T, ".", color="0.5", markersize=3)
    left.loglog(x, 1e-12 * seen.values[n_fitted:].T, "x", color="C3", markersize=4)
    left.set(xlabel="pressure (MPa)", ylabel="interface stiffness (MPa/µm)")
    left.legend(title="dots fitted, crosses held out", fontsize="small")
    save_figure(left.figure, out / "measured_stiffness.png")
    return 0


def _within(ends: np.ndarray, middle: np.ndarray) -> str:
    distance = np.max(np.abs(ends / middle - 1.0))
    return f"{100.0 * distance:.2g} %" if np.isfinite(distance) else "an unknown distance"


def write_table(file: Path) -> Path:
    """Write the stiffness of eight specimens at ten pressures."""
    random, lines = np.random.default_rng(seed=1), ["pressure (MPa),stiffness (MPa/um),specimen"]
    for specimen, scatter in enumerate(0.1 * random.normal(size=8)):
        for p in np.geomspace(0.5, 60.0, 10):
            stiffness = 3.0 * p**0.6 * np.exp(scatter + 0.03 * random.normal())
            lines.append(f"{p:.4g},{stiffness:.4g},{specimen}")
    file.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return file


if __name__ == "__main__":
    raise SystemExit(main())

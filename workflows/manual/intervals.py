"""Measure the share of stated 95 % intervals that contain the truth, over many seeded scenes.

    python workflows/manual/intervals.py [--scenes N]

from the root of a checkout draws scenes of flat cells, which differ in Hurst exponent, band, slope
and pressures. The truth of a scene is the mean of 32 realisations, pressed in half the steps and
beyond the ends of the data. A law is fitted to ensembles of 3 and 6 others, and the error of each
step is compared with the total error of its budget. ``workflows/coverage.md`` has the result.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from time import process_time

import numpy as np

from multiscale.micro import Cell, run_ensemble, self_affine
from multiscale.micro import Path as LoadPath
from multiscale.schema import Dataset
from multiscale.upscaling import area_from_dataset, error_budget, fit_law, law_from_dataset

FOLDER = Path(__file__).parents[1]
MODULUS, NU, EDGE = 1e9, 0.3, 1e-3  # Pa, 1, m
TRUTH, OTHERS, SIZES = 32, 12, (3, 6)  # realisations of the truth and others; of an ensemble
QUANTITIES = ("mean gap", "contact fraction", "stiffness")
HEAD = """\
# Coverage of intervals

Share of stated 95 % intervals that contain the truth, in {scenes} scenes of flat cells (Hurst
exponent 0.3 to 0.9, one or two longest wavelengths per edge, band two to four, slope 0.02 to 0.2,
pressures over a factor of 10 to 100), each with {ensembles} ensembles of {sizes} realisations;
the truth are {truth} other realisations. After ± is the 95 % interval of the mean over the
scenes. (`python workflows/manual/intervals.py`, {day}, {seconds:.0f} processor seconds)

| quantity | {heads} |
| --- | {rules} |
"""


@dataclass(frozen=True)
class Scene:
    """Waves per edge, longest over shortest wavelength, and pressures over E* times the slope."""

    hurst: float
    waves: int
    band: int
    slope: float
    pressures: np.ndarray
    points: int = 16
    family: str | None = None


def main() -> None:
    """Evaluate the coverage of all scenes, and write table and figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=100, help="number of scenes")
    count = parser.parse_args().scenes
    begin = process_time()
    shares = np.array([coverage(k, scene) for k, scene in enumerate(draw_scenes(count))])
    mean, half = shares.mean(axis=0), 1.96 * shares.std(axis=0, ddof=1) / np.sqrt(count)
    text = HEAD.format(
        scenes=count,
        ensembles=sum(OTHERS // n for n in SIZES),
        sizes=" and ".join(map(str, SIZES)),
        truth=TRUTH,
        day=datetime.now(UTC).date(),
        seconds=process_time() - begin,
        heads=" | ".join(f"{n} realisations, %" for n in SIZES),
        rules=" | ".join("---" for _ in SIZES),
    )
    for j, quantity in enumerate(QUANTITIES):
        cells = (f"{100.0 * mean[i, j]:.1f} ± {100.0 * half[i, j]:.1f}" for i in range(len(SIZES)))
        text += f"| {quantity} | {' | '.join(cells)} |\n"
    picture = "![Share of intervals that contain the truth, by scene](figures/coverage.png)"
    (FOLDER / "coverage.md").write_text(f"{text}\n{picture}\n", encoding="utf-8")
    draw(shares, FOLDER / "figures" / "coverage.png")


def draw_scenes(count: int) -> Iterator[Scene]:
    """Yield seeded scenes with at least four points per shortest wavelength."""
    random = np.random.default_rng(seed=1)
    while count:
        waves, band = int(random.integers(1, 3)), int(random.integers(2, 5))
        hurst, slope = random.uniform(0.3, 0.9), random.uniform(0.02, 0.2)
        low, ratio = random.uniform(0.005, 0.03), random.uniform(10.0, 100.0)
        steps = int(random.integers(5, 7))
        if waves * band <= 4:
            pressures = np.geomspace(low, min(ratio * low, 0.5), steps)
            yield Scene(hurst, waves, band, slope, pressures)
            count -= 1


def coverage(
    number: int,
    scene: Scene,
    sizes: tuple[int, ...] = SIZES,
    *,
    truth: int = TRUTH,
    others: int = OTHERS,
) -> np.ndarray:
    """Return the share of the steps of ensembles that is covered, (sizes, quantities)."""
    response = press(number, scene, truth, others)
    many = response.isel(realisation=slice(truth))
    data = response.isel(step=slice(1, None, 2))
    pressure = data["nominal_pressure"].values
    gap, area = (
        many[name].where(many["converged"] == 1).mean("realisation").to_numpy()[1::2]
        for name in ("mean_gap", "contact_fraction")
    )
    exact = np.array([gap, area, values_of(fit_law(many, n_samples=0), pressure)[2]])
    shares = []
    for n in sizes:
        covered = []
        for first in range(truth, truth + others, n):
            few = data.isel(realisation=slice(first, first + n))
            law = fit_law(few, family=scene.family, n_samples=0)
            value, total = values_of(law, pressure), error_budget(few, law)["error_total"].values
            covered.append(np.abs(value - exact) <= total * np.abs(value))
        shares.append(np.mean(covered, axis=(0, 2)))
    return np.array(shares)


def press(number: int, scene: Scene, truth: int, others: int) -> Dataset:
    """Return the response of all realisations of a scene at the halved steps."""
    cells = [
        Cell(
            self_affine(
                (scene.points, scene.points),
                (EDGE, EDGE),
                100_000 * number + seed,
                hurst_exponent=scene.hurst,
                long_cutoff=EDGE / scene.waves,
                short_cutoff=EDGE / scene.waves / scene.band,
                rms_slope=scene.slope,
            ),
            EDGE,
            8,
            MODULUS,
            NU,
            geometry="flat",
        )
        for seed in (*range(truth), *range(2 * truth, 2 * truth + others))
    ]
    pressure = MODULUS / (1.0 - NU**2) * scene.slope * halved(scene.pressures)
    return run_ensemble(cells, LoadPath(pressure=tuple(pressure)))


def halved(pressure: np.ndarray) -> np.ndarray:
    """Return pressures, those half way between them, and half a step beyond either end."""
    x = np.log(pressure)
    places = np.arange(-0.5, x.size, 0.5)
    inner = np.interp(places, np.arange(x.size), x)
    inner[0], inner[-1] = 1.5 * x[0] - 0.5 * x[1], 1.5 * x[-1] - 0.5 * x[-2]
    return np.exp(inner)


def values_of(law: Dataset, pressure: np.ndarray) -> np.ndarray:
    """Return gap, contact fraction and stiffness of a law at pressures."""
    normal = law_from_dataset(law)
    gap = normal.gap_at(pressure)
    fraction = area_from_dataset(law).contact_fraction(pressure)
    return np.array([gap, fraction, normal.stiffness(gap)])


def draw(shares: np.ndarray, file: Path) -> None:
    """Draw the distribution of the coverage over the scenes, by quantity and ensemble."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 2.4), layout="constrained")
    for j, ax in enumerate(figure.subplots(1, len(QUANTITIES), sharey=True)):
        for i, n in enumerate(SIZES):
            sorted_shares = 100.0 * np.sort(shares[:, i, j])
            rank = np.arange(1, len(shares) + 1) / len(shares)
            ax.step(
                sorted_shares, 100.0 * rank, where="post", color=f"C{i}", label=f"{n} realisations"
            )
        ax.axvline(95.0, color="0.6", linewidth=0.8)
        ax.set_title(QUANTITIES[j])
        ax.set_xlabel("coverage of a scene (%)")
    figure.axes[0].set_ylabel("share of scenes (%)")
    figure.axes[0].legend(frameon=False)
    figure.savefig(file, dpi=100)


if __name__ == "__main__":
    main()

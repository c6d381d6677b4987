"""Answers of the chain and of solids: the error of each against the run time from its data."""

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from multiscale.bench.measure import BenchFamily, Row, Runner, judge
from multiscale.micro.damage import (
    FatigueMaterial,
    Recipe,
    effective_stiffness,
    two_scale_fatigue,
    voxelise,
    youngs_modulus_along,
)
from multiscale.schema import Dataset

# ---------------------------------------------------------------------------------------------
# chain: stiffness of an interface of a shipped case, from surface to answer

CASE, PRELOAD = "ground_steel", 2
"""The shipped case, and the number of its preload that is measured."""
SAMPLES, APART = 4, 1000
"""Number of independent answers, over which an error is averaged; distance of the seeds of chains,
larger than the number of cells of any chain."""


def interface_stiffness(points: int, realisations: int, sample: int) -> tuple[float, float]:
    """Run a sample of the case: stiffness of the interface and half of its 95 % interval, Pa/m."""
    from multiscale.pipeline import Case, load_case, run

    case = load_case(CASE)
    assert isinstance(case, Case)  # as this shipped case is
    cell = case.cell.model_copy(update={"points": (points, points)})
    seed = case.micro.seed + APART * sample
    # the ladder measures the error of the grid itself, without cells on half of the points
    changes = {"realisations": realisations, "seed": seed, "coarser": 0}
    micro = case.micro.model_copy(update=changes)
    with TemporaryDirectory() as folder:
        results = run(case.model_copy(update={"cell": cell, "micro": micro}), Path(folder))
    at = results.macro_result.isel(step=PRELOAD)
    low, high = at["interface_stiffness_mean_law"].values
    return float(at["interface_stiffness"]), 0.5 * float(high - low)


def interface_stiffnesses(points: int, realisations: int, samples: int = SAMPLES) -> np.ndarray:
    """Return the stiffness of several runs, Pa/m."""
    return np.array([interface_stiffness(points, realisations, k)[0] for k in range(samples)])


# the same chain on a surface with closed forms: a wave in one direction, pressed to s p*

AMPLITUDE, WAVELENGTH, MODULUS = 1e-6, 100e-6, 115e9  # m, m, and contact modulus, Pa
CLOSING = np.pi * MODULUS * AMPLITUDE / WAVELENGTH  # p*, Pa
PRESSED, SHEARED = 0.3, 0.6  # p over p*, and shear over the friction limit
FRICTION, RATIO = 0.2, 0.8
EDGE, HEIGHT, DENSITY = 1.0, 1e-4, 7800.0  # of rigid blocks, m and kg/m³: too flat to tilt
RIGID = 1e18  # Young's modulus of the blocks, Pa


def wave_law(points: int) -> Dataset:
    """Press a cell with a wave, and fit its law with its leakage."""
    from multiscale.micro import Cell, Path, Surface, run_ensemble
    from multiscale.upscaling import fit_law
    from multiscale.upscaling.transport import with_leakage

    x = np.arange(points) / points
    heights = AMPLITUDE * np.cos(2.0 * np.pi * x)[:, None] * np.ones(2)
    surface = Surface(heights, (WAVELENGTH, 2.0 * WAVELENGTH / points))
    youngs_modulus = (1.0 - POISSON**2) * MODULUS
    cell = Cell(surface, 1.5 * WAVELENGTH, 24, youngs_modulus, POISSON, geometry="flat")
    pressures = tuple(CLOSING * np.geomspace(0.02, 0.8, 16))
    response = run_ensemble([cell], Path(pressure=pressures), keep_flow=True)
    law = fit_law(response, n_samples=0)
    return with_leakage(law.assign_attrs(cell_size=WAVELENGTH, longest_wave=WAVELENGTH), response)


def wave_answer(scene: str, points: int) -> float:
    """Return the answer of a scene, from the surface: Pa/m, m³, J or Hz."""
    from multiscale.laws.bulk import Elastic
    from multiscale.macro import vibration
    from multiscale.macro.bodies import stacked_blocks
    from multiscale.macro.substructures import AssembledNewton, joint_path, load_joint
    from multiscale.upscaling import assume_shear, law_from_dataset, sliders_from_dataset

    law, pressure = wave_law(points), PRESSED * CLOSING
    if scene == "leak rate along a wave":
        along = law["hydraulic_aperture"].sel(direction="y").to_numpy() ** 3 / 12.0
        return float(np.interp(np.log(pressure), np.log(law["fit_pressure"]), along))
    normal = law_from_dataset(law)
    if scene == "stiffness of a wave":
        return float(normal.stiffness(normal.gap_at(np.array(pressure))))
    sheared = assume_shear(law, friction=FRICTION, stiffness_ratio=RATIO)
    bed = sliders_from_dataset(sheared, slabs=3 * points)
    size = (EDGE, EDGE, HEIGHT)
    blocks = stacked_blocks(size, (1, 1, 1), [Elastic(RIGID, 0.0)] * 2, [bed])
    if scene == "loss of a joint in shear":
        shear = SHEARED * FRICTION * pressure
        loading = joint_path((pressure,), shear, cycles=1, steps=8)
        return float(load_joint(blocks, loading, method=AssembledNewton())["cycle_energy"][-1])
    rest = vibration.press_structure(blocks, np.array([[pressure, 0.0]]))
    mass = vibration.structure_mass(rest.free, blocks.bodies, [DENSITY] * 2)
    modes = vibration.tangent_modes(rest.free, rest.tangent(), mass, 6)
    moved = np.abs(modes.nodal(rest.free)[..., 2].mean(axis=1))
    return float(modes.frequency[np.argmax(moved)])


def wave_exact(scene: str) -> float:
    """Return the closed form of a scene (H. M. Westergaard, J. Appl. Mech. 6 (1939) A49-A53)."""
    from scipy.integrate import quad

    # y = |sin(pi x / lambda)|, y² > s = p / p*: g = 2 D [y sqrt(y² - s) - s arcosh(y / sqrt s)],
    # mean gap D (1 - s + s ln s), K = p* / (D ln(1/s))
    s = PRESSED
    stiffness = CLOSING / (AMPLITUDE * np.log(1.0 / s))
    if scene == "stiffness of a wave":
        return float(stiffness)
    if scene == "frequency of a block":
        return float(np.sqrt(stiffness / (DENSITY * HEIGHT)) / (2.0 * np.pi))
    if scene == "leak rate along a wave":

        def cube(angle: float) -> float:
            y = np.sin(angle)
            return float((y * np.sqrt(y**2 - s) - s * np.arccosh(y / np.sqrt(s))) ** 3)

        first = float(np.arcsin(np.sqrt(s)))
        mean = 2.0 / np.pi * quad(cube, first, np.pi / 2.0)[0]
        return float((2.0 * AMPLITUDE) ** 3 * mean / 12.0)

    # loss of a Masing loop, with t = mu (p - q) and the slip mu / kappa of the mean gaps
    def slip(q: float) -> float:
        return float(FRICTION / RATIO * AMPLITUDE * ((q * np.log(q) - q) - (s * np.log(s) - s)))

    shear, turned = SHEARED * FRICTION * s * CLOSING, s * (1.0 - SHEARED)
    work = FRICTION * CLOSING * quad(slip, turned, s)[0]  # of the slip on the shear
    return float(EDGE**2 * 4.0 * (shear * slip(turned) - 2.0 * work))


WAVE_SCENES = (
    "stiffness of a wave",
    "leak rate along a wave",
    "loss of a joint in shear",
    "frequency of a block",
)


@partial(BenchFamily, "whole chain: from surface to answer", packages=("scipy", "numba"))
def chain(run: Runner, quick: bool) -> Iterator[Sequence[Row]]:
    """Run a wave with closed forms, and but for ``quick`` the case with several realisations."""
    for scene in WAVE_SCENES[1:3] if quick else WAVE_SCENES:
        rows = [
            run(scene, f"{points} points a wave", wave_answer, scene, points, warm=(scene, 16))
            for points in ((64,) if quick else (16, 32, 64, 128, 256, 512))
        ]
        yield judge(rows, wave_exact(scene), 0.0)
    if quick:
        return
    grids, counts = (48, 64, 96, 128), (3, 6, 12)
    rows = [
        run(
            "stiffness of an interface of ground steel",
            f"{points} x {points} points",
            *(interface_stiffnesses, points, count),
            warm=(34, 3, 1),
            realisations=count,
        )
        for points in grids
        for count in counts
    ]
    exact, half = interface_stiffness(grids[-1], 4 * counts[-1], SAMPLES)
    yield judge(rows, exact, half / exact)


# ---------------------------------------------------------------------------------------------
# laws: stiffness of a fitted law against the time of its cells

YOUNG, POISSON, SLOPE = 210e9, 0.3, 0.1  # Pa, 1, 1
SIZE, LONGEST, SHORTEST = 80e-6, 20e-6, 10e-6
"""Edge of the cells, longest and shortest wavelength, m."""
POINTS = 64
LOWEST, ASKED, HIGHEST = 0.2e9, 1e9, 4e9
"""Range of the pressures of the cells, and the pressure of the measured stiffness, Pa."""
MOST = 32  # largest number of realisations of a law
SHARES = 8
"""Number of equal shares of the realisations of the truth; their scatter is the uncertainty."""


def fitted_stiffness(family: str, seeds: Iterable[int]) -> float:
    """Press cells and fit a law of a family: its stiffness at 1 GPa, Pa/m."""
    from multiscale.micro import Cell, Path, run_ensemble, self_affine
    from multiscale.upscaling import fit_law, law_from_dataset

    surfaces = [
        self_affine(
            (POINTS, POINTS),
            (SIZE, SIZE),
            int(seed),
            hurst_exponent=0.8,
            long_cutoff=LONGEST,
            short_cutoff=SHORTEST,
            rms_slope=SLOPE,
        )
        for seed in seeds
    ]
    cells = [Cell(surface, SIZE, 8, YOUNG, POISSON, geometry="flat") for surface in surfaces]
    response = run_ensemble(cells, Path(pressure=tuple(np.geomspace(LOWEST, HIGHEST, 8))))
    law = law_from_dataset(fit_law(response, family=family, n_samples=0))
    return float(law.stiffness(law.gap_at(np.array([ASKED])))[0])


def fitted_stiffnesses(family: str, count: int, samples: int = SAMPLES) -> np.ndarray:
    """Return the stiffness of several ensembles, Pa/m."""
    ensembles = np.arange(samples * count).reshape(samples, count)
    return np.array([fitted_stiffness(family, seeds) for seeds in ensembles])


@partial(BenchFamily, "interface laws: stiffness at 1 GPa", packages=("scipy",))
def laws(run: Runner, quick: bool) -> Iterator[Sequence[Row]]:
    """Fit laws of several families to ensembles of flat cells of growing size."""
    rows = [
        run(
            "stiffness of a rough interface",
            family.replace("_", " "),
            *(fitted_stiffnesses, family, count),
            warm=("power", 2, 1),
            realisations=count,
        )
        for family in ("convex_decreasing", "exponential", "power")
        for count in ((2, 4) if quick else (2, 4, 8, 16, MOST))
    ]
    first = SAMPLES * MOST  # after the seeds of the ensembles
    shares = np.arange(first, first + (16 if quick else 1024)).reshape(SHARES, -1)
    truth = np.array([fitted_stiffness("convex_decreasing", seeds) for seeds in shares])
    spread = 2.0 * truth.std(ddof=1) / np.sqrt(SHARES) / truth.mean()
    yield judge(rows, float(truth.mean()), float(spread))


# ---------------------------------------------------------------------------------------------
# volumes: stiffness of a porous solid over size, number and voxels of its volumes

CASTING = Recipe(porosity=0.06, pore_radius=120e-6, pore_spread=0.25)
"""Pores of the shipped case ``porous_bracket``."""

WAYS = {
    "larger volumes": tuple((size, 1, 24) for size in (0.5e-3, 1e-3, 2e-3)),
    "more volumes": tuple((0.5e-3, count, 24) for count in (1, 4, 16)),
    "smaller voxels": tuple((1e-3, 4, voxels) for voxels in (8, 16, 32)),
}
"""Edge of the volumes, m, their number, and voxels along 1 mm, by the kind of refinement."""


def mean_moduli(size: float, count: int, voxels: int, seeds: Sequence[int]) -> list[float]:
    """Return the mean Young's modulus of volumes along their edges, Pa, for each seed."""

    def modulus(seed: int) -> float:
        image = voxelise(CASTING.draw((size,) * 3, seed), round(voxels * size / 1e-3))
        C = effective_stiffness(image, 71e9, 0.33).unwrap()
        return float(youngs_modulus_along(C, np.eye(3)).mean())

    return [float(np.mean([modulus(seed + k) for k in range(count)])) for seed in seeds]


@partial(BenchFamily, "stiffness of a porous solid: error against run time", packages=("numba",))
def volumes(run: Runner, quick: bool) -> Iterator[Sequence[Row]]:
    """Compute the stiffness of a porous solid by larger, more and finer volumes."""
    seeds = range(1000, 3000 if quick else 7000, 1000)
    rows = [
        run(
            "Young's modulus of a casting with 6 % of pores",
            way,
            *(mean_moduli, size, count, voxels, seeds),
            warm=(0.5e-3, 1, 8, [0]),
            points=round(voxels * size / 1e-3),
            realisations=count,
        )
        for way, steps in WAYS.items()
        for size, count, voxels in steps[: 2 if quick else None]
    ]
    size, count = (1e-3, 8) if quick else (1.5e-3, 12)
    exact, coarser = (mean_moduli(size, count, voxels, [0])[0] for voxels in (48, 24))
    yield judge(rows, exact, abs(coarser / exact - 1.0))


# ---------------------------------------------------------------------------------------------
# damage: fatigue lives by jumps over cycles

MATERIAL = FatigueMaterial(
    200e9, 0.3, 200e6, 0.5e6, 2.0, hardening=20e9, threshold=0.05, closure=0.2
)
"""Material with feedback of damage, closure and hardening, which make cycles differ."""

DAMAGE_SCENES = (
    "reversed tension, 1.001 of the limit",
    "tension and torsion",
    "blocks of three kinds",
)
SUBSTEPS = 16  # number of substeps of every branch of a cycle; four times as many give their error


def stress_history(scene: str) -> np.ndarray:
    """Return the corners of a cycle of stress, or of a program of cycles, of a scene, Pa."""
    limit = MATERIAL.fatigue_limit
    reversed_tension = limit * np.array([1.0, -1.0])
    if scene == DAMAGE_SCENES[0]:
        return 1.001 * reversed_tension
    if scene == DAMAGE_SCENES[1]:  # out of phase: the principal axes turn
        angle = np.arange(8) * np.pi / 4.0
        path = np.zeros((8, 6))
        path[:, 0], path[:, 5] = np.cos(angle), np.sin(angle) / np.sqrt(3.0)
        return 1.05 * limit * path
    blocks = ((1.05, 5), (0.9, 10), (1.15, 1))  # amplitude over the limit, cycles
    return np.concatenate([np.tile(share * reversed_tension, count) for share, count in blocks])


def life(scene: str, tolerance: float | None, substeps: int = SUBSTEPS) -> tuple[float, float]:
    """Return the cycles to rupture, and the number of cycles that were computed."""
    history = two_scale_fatigue(
        stress_history(scene), MATERIAL, jump_tolerance=tolerance, substeps=substeps
    )
    return float(history["cycles_to_rupture"]), float(history["computed_cycles"])


@partial(BenchFamily, "two-scale fatigue: error of the life against run time", packages=("numba",))
def damage(run: Runner, quick: bool) -> Iterator[Sequence[Row]]:
    """Compute lives cycle by cycle, and by jumps of several tolerances."""
    jumps = (0.1, 0.01) if quick else (0.3, 0.1, 0.03, 0.01, 0.003, 0.001)
    for scene in DAMAGE_SCENES[1:2] if quick else DAMAGE_SCENES:
        rows = [
            run(
                scene,
                "cycle jumps" if tolerance else "every cycle",
                *(life, scene, tolerance),
                warm=(DAMAGE_SCENES[1], 0.3),
                repeats=1 if quick else 3,
                tolerance=tolerance or 0.0,
            )
            for tolerance in (None, *jumps)
        ]
        for row in rows:
            row["value"], row["iterations"] = row["value"] or (np.nan, np.nan)
        exact, _ = life(scene, None)
        judge(rows, exact, abs(exact / life(scene, None, 4 * SUBSTEPS)[0] - 1.0))
        rows[0]["error"] += rows[0]["error_uncertainty"]  # NaN if it did not end
        yield rows

"""Solve a rough structure with a law, with cells at all points, and with resolved roughness.

*Sequential*: cells are pressed, a law is fitted, the structure is solved with it; *law at hand* is
this solve only. *Adaptive*: the cells are pressed under three pressures, and at further pressures
of the structure, like `way = "adaptive"` of a case. *Concurrent*: a cell is solved for each
pressure of the structure. *Direct*: all roughness is in the model of the structure. The scenes are
a rough wave and a joint of two blocks under a tilted platen; the longest wavelength of the
roughness is 1/4 to 1/32 of their length. Guide 11 uses the functions below.

    python workflows/three_ways.py -o three_ways [--quick]

writes the dataset ``work_precision.nc`` and its figure, error of the mean gap against run time of
an answer, in a quarter of an hour; ``--quick`` takes one ratio, coarse grids, few surfaces.

The reference of a structure with a given surface is extrapolated from the finest grids, with a
bound of its error as uncertainty. ``error`` is the root mean square over the structures, because a
law or a cell does not depend on the given surface; ``mean_error`` is the error of their mean.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import circulant
from scipy.sparse import csr_array, eye_array, hstack, kron, vstack

from multiscale.errors import CaseError, ConvergenceError
from multiscale.fe.elasticity import elastic_matrix
from multiscale.fe.faces import face_operator
from multiscale.fe.mesh_file import plane_block
from multiscale.io import make_folder, write_dataset
from multiscale.laws import AreaLaw, NormalLaw
from multiscale.laws.bulk import Elastic
from multiscale.macro import Body, Contact, FiniteAssembly, solve_contact, solve_interface
from multiscale.macro.continuum.body import fixed_motion
from multiscale.macro.data_range import (
    FAR_FACTOR,
    FAR_SHARE,
    data_ends,
    further_pressures,
    load_shares,
)
from multiscale.micro import (
    CellLaw,
    FlatCell,
    Surface,
    contact_modulus,
    run_ensemble,
    self_affine,
    solve_cell,
)
from multiscale.micro import Path as LoadPath
from multiscale.numerics.factorisation import on_diagonal
from multiscale.pipeline.adaptive import ROUNDS
from multiscale.plotting import draw_work_precision
from multiscale.schema import WORK_PRECISION, Dataset
from multiscale.upscaling import area_from_dataset, estimate_grid_error, fit_law, law_from_dataset
from multiscale.upscaling.response_observations import join_pressures

BAND = 4.0  # longest over shortest wavelength of the roughness
CELL_WAVES = 4  # longest wavelengths of the roughness along an edge of a cell
FEW = slice(4, 7)  # first pressures of adaptive cells, among the pressures of sequential cells
BELOW = 0.1  # lowest pressure of a concurrent cell over the lowest of a law
STEEL = Elastic(210e9, 0.3)


class Answer(NamedTuple):
    """Averages over a structure, and the pressure along it."""

    mean_gap: float  # m
    contact_fraction: float  # NaN if unknown
    position: np.ndarray  # (points,), along the structure, m
    pressure: np.ndarray  # (points,), averaged across the structure, Pa


@dataclass(frozen=True)
class RoughStructure:
    """A structure with a self-affine interface, Hurst exponent 0.8.

    ``ratio``, the longest wavelength of the roughness over the length of the structure, is the
    inverse of a whole number of at least 4.
    """

    length = 1.0  # m
    rms_height = 0.0  # m
    areal = True  # whether the roughness varies in both directions, or is a profile

    ratio: float

    def __post_init__(self) -> None:
        waves = 1.0 / self.ratio if self.ratio > 0.0 else 0.0
        if waves < 4.0 - 1e-9 or abs(waves - round(waves)) > 1e-9 * waves:
            raise CaseError(
                f"ratio must be the inverse of a whole number of at least 4, such as 1/8, got "
                f"{self.ratio:g}"
            )

    def surface(self, seed: int, points_per_wave: int, waves: int | None = None) -> Surface:
        """Build the roughness of a square of some longest wavelengths, or of the structure."""
        waves = round(1.0 / self.ratio) if waves is None else waves
        n, edge = round(BAND * points_per_wave * waves), waves * self.ratio * self.length
        return self_affine(
            (n, n if self.areal else 1),
            (edge, edge if self.areal else edge / n),
            seed,
            hurst_exponent=0.8,
            long_cutoff=self.ratio * self.length,
            short_cutoff=self.ratio * self.length / BAND,
            rms_height=self.rms_height,
        )


class RoughWave(RoughStructure):
    r"""An elastic half-space with a rough wave, pressed against a rigid plane.

    The wave :math:`\Delta \cos(2\pi x/\lambda)` with :math:`\Delta = 0.01\,\lambda` carries half of
    the mean pressure that closes it when smooth. Resolved, it is a flat cell of a period with wave
    and roughness on it; with a law, a wave in plane strain: the displacement of the surface is the
    change of the gap g, so that with the stiffness K of the half-space and the weights w

    .. math:: K (g - g_0) + w\,t(g) = -w\,p.    \tag{1}
    """

    length, rms_height, points = 1e-3, 2e-6, 256
    amplitude = 1e-5  # of the wave, m
    modulus = contact_modulus((STEEL.youngs_modulus, STEEL.poissons_ratio))
    pressure = 0.5 * np.pi * modulus * amplitude / length
    pressures = pressure * np.geomspace(0.05, 4.0, 10)  # of cells: from the rim to beyond the crest

    def cell(self, surface: Surface) -> FlatCell:
        """Build a flat cell, deep enough for a half-space."""
        return FlatCell(surface, 2.0 * max(surface.size), 8, STEEL)

    def wave(self, points: int) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and heights of the smooth wave, m."""
        x = self.length * np.arange(points) / points
        return x, self.amplitude * np.cos(2.0 * np.pi * x / self.length)

    def solve(self, law: NormalLaw, area: AreaLaw | None = None) -> Answer:
        """Solve the wave with a law of its roughness."""
        x, wave = self.wave(self.points)
        K = half_space_stiffness(self.points, self.length, self.modulus)
        weight = np.full(self.points, self.length / self.points)
        solution = solve_interface(
            K,
            K @ (self.amplitude - wave) - weight * self.pressure,  # (1)
            eye_array(self.points, format="csr"),
            weight,
            law,
            start=np.full(self.points, float(law.gap_at(np.array(self.pressure))) - law.gap),
            tolerance=1e-8,
        )
        gap = solution.unwrap() + law.gap
        pressure = law.pressure(gap)
        fraction = np.nan if area is None else float(np.mean(area.contact_fraction(pressure)))
        return Answer(float(np.mean(gap)), fraction, x, pressure)

    def resolve(self, seed: int, points_per_wave: int) -> Answer:
        """Solve the wave with its roughness on it."""
        rough = self.surface(seed, points_per_wave)
        n = rough.heights.shape[0]
        x, wave = self.wave(n)
        surface = Surface(rough.heights + wave[:, None], rough.size)
        path = LoadPath(pressure=(self.pressure,))
        response = solve_cell(self.cell(surface), path, keep_fields=True)
        if not response["converged"].values.all():
            raise ConvergenceError(
                f"the wave with its roughness resolved by {n} x {n} points did not converge; "
                f"lower points_per_wave"
            )
        step = response.isel(realisation=0, step=0)
        pressure = step["pressure"].values.mean(axis=0)
        return Answer(float(step["mean_gap"]), float(step["contact_fraction"]), x, pressure)


def half_space_stiffness(points: int, length: float, contact_modulus: float) -> np.ndarray:
    """Return the surface stiffness of a half-space, periodic, in plane strain."""
    q = 2.0 * np.pi * np.abs(np.fft.fftfreq(points, length / points))
    return np.asarray(circulant(np.fft.ifft(0.5 * contact_modulus * q).real) * (length / points))


class TiltedJoint(RoughStructure):
    r"""Two steel blocks in plane strain between platens; the upper platen is tilted.

    Each block is as wide as :math:`\ell` and half as high. The upper platen comes down by

    .. math:: \delta(x) = \delta_0 \left(1 + a\,\frac{2x}{\ell}\right)    \tag{1}

    from where the mean planes coincide, so that the pressure varies from a fifth to nine fifths of
    its mean. Resolved, the face of the upper block is meshed with the profile; with a law, both
    blocks are plane. Cells are profiles with the contact modulus of both blocks.
    """

    length, rms_height, points, areal = 0.02, 4e-6, 64, False
    bulk = STEEL  # of both blocks
    tilt, approach = 0.8, 2e-5  # a, delta_0 in m

    @property
    def moduli(self) -> tuple[float, float]:
        """Young's modulus, Pa, and Poisson's ratio."""
        return float(self.bulk.youngs_modulus), float(self.bulk.poissons_ratio)

    @property
    def pressures(self) -> np.ndarray:
        """Mean pressures of cells, Pa: from the light edge to beyond the heavy edge."""
        return 1e-3 * contact_modulus(self.moduli) * np.geomspace(0.03, 4.0, 12)

    def cell(self, surface: Surface) -> FlatCell:
        """Build a flat profile with the contact modulus of both blocks."""
        both = contact_modulus(self.moduli, self.moduli) * (1.0 - self.moduli[1] ** 2)
        return FlatCell(surface, 2.0 * max(surface.size), 8, Elastic(both, self.moduli[1]))

    def solve(self, law: NormalLaw, area: AreaLaw | None = None, *, refined: int = 1) -> Answer:
        """Solve the joint with a law of its roughness; layers grow away from the interface."""
        # stiffness of both blocks, and the motion of the platens
        bodies = self.bodies(np.zeros(refined * self.points))
        K = on_diagonal(elastic_matrix(body.basis, self.bulk) for body in bodies)
        n = bodies[0].basis.doflocs.size
        (below, motion_below), (above, motion_above) = (fixed_motion(body, 1.0) for body in bodies)
        fixed, u = np.append(below, n + above), np.zeros(K.shape[0])
        u[fixed] = np.append(motion_below, motion_above)
        free = np.setdiff1d(np.arange(u.size), fixed)
        # jump of the faces, and a start near the mean pressure
        (lower, _, _), (upper, weight, position) = (
            face_operator(body.basis, "face") for body in bodies
        )
        axes = np.array([[[0.0, 1.0]], [[1.0, 0.0]]])  # normal first
        B = csr_array(vstack([hstack([-kron(lower, axis), kron(upper, axis)]) for axis in axes]))
        start, typical = np.zeros(u.size), self.approach / self.length * self.moduli[0]
        start[n + 1 :: 2] = float(law.gap_at(np.array(typical))) - law.gap
        solution = solve_interface(
            csr_array(K[free][:, free]),
            -(K @ u)[free],
            csr_array(B[:, free]),
            weight,
            law,
            start=start[free],
            tolerance=1e-8,
        )
        gap = (B[:, free] @ solution.unwrap())[: weight.size] + law.gap
        pressure, mean = law.pressure(gap), weight / weight.sum()
        local = np.full(gap.size, np.nan) if area is None else area.contact_fraction(pressure)
        return Answer(float(mean @ gap), float(mean @ local), position[0], pressure)

    def resolve(self, seed: int, points_per_wave: int) -> Answer:
        """Solve the joint with the profile on the face of the upper block."""
        return self.mesh_profile(self.surface(seed, points_per_wave).heights[:, 0])

    def mesh_profile(self, profile: np.ndarray) -> Answer:
        """Solve the joint with a periodic profile, m, positive into the lower block."""
        # the mesh starts above the lower block: the displacement of the platen includes this
        # distance
        lower, upper = self.bodies(profile, float(np.max(profile)))
        problem = FiniteAssembly(
            {"lower": lower, "upper": upper},
            {"interface": Contact(("upper", "face"), ("lower", "face"))},
        )
        face = solve_contact(problem, tolerance=1e-8)[-1].unwrap().contact["interface"]
        mean, closed = face.area / face.area.sum(), face.pressure > 0.0
        return Answer(float(mean @ face.gap), float(mean @ closed), face.position[0], face.pressure)

    def bodies(self, profile: np.ndarray, lift: float = 0.0) -> tuple[Body, Body]:
        """Mesh the lower block, and the upper block with a profile, above by a lift, m."""
        size = self.length, 0.5 * self.length

        def come_down(x: np.ndarray, time: float) -> np.ndarray:
            delta = self.approach * (1.0 + self.tilt * 2.0 * x[0] / self.length)  # (1)
            return np.asarray(-time * (delta + lift))

        lower = plane_block(size, np.zeros(profile.size), upper=False)
        upper = plane_block(size, profile, upper=True, lift=lift)
        return (
            Body(lower, self.bulk, {"back": (0.0, 0.0)}),
            Body(upper, self.bulk, {"back": (0.0, come_down)}),
        )


Structure = RoughWave | TiltedJoint


@dataclass(frozen=True, eq=False)
class Way:
    """Answers by one of the ways, and their cost."""

    answers: tuple[Answer, ...]  # of every realisation, or of all realisations together
    seconds: float  # wall time of all
    solve_seconds: float  # of the structure only, with a given law; else as ``seconds``
    solved: int = 0  # cells, counted at each load step
    reused: int = 0  # answers by cells that were solved before
    response: Any = None  # follows MICRO_RESPONSE; of the sequential way only

    @property
    def gaps(self) -> np.ndarray:
        """Mean gap of every answer, m."""
        return np.array([answer.mean_gap for answer in self.answers])

    @property
    def mean_gap(self) -> float:
        """Mean over the realisations, m."""
        return float(np.mean(self.gaps))


def solve_sequential(
    structure: Structure,
    seeds: Sequence[int],
    *,
    points_per_wave: int = 8,
    waves: int = CELL_WAVES,
    adaptive: bool = False,
) -> Way:
    """Press cells, fit a law to all of them and solve the structure with it."""
    begin = perf_counter()
    cells = [structure.cell(structure.surface(seed, points_per_wave, waves)) for seed in seeds]
    pressures = tuple(structure.pressures[FEW] if adaptive else structure.pressures)
    response: Dataset = run_ensemble(cells, LoadPath(pressure=pressures))
    for _ in range(ROUNDS):
        dataset = fit_law(response, n_samples=0)
        law, area = law_from_dataset(dataset), area_from_dataset(dataset)
        fitted = perf_counter()
        answer = structure.solve(law, area)
        end = perf_counter()
        further = further_pressures(data_ends(law), shares_of(answer, law)) if adaptive else ()
        if not further:
            break
        response = join_pressures(response, run_ensemble(cells, LoadPath(pressure=further)))
    solved = int(response["converged"].sum())
    shared = answer.pressure.size * len(cells) if adaptive else 0
    return Way((checked(answer, law),), end - begin, end - fitted, solved, shared, response)


solve_adaptive = partial(solve_sequential, adaptive=True)


def shares_of(answer: Answer, law: NormalLaw) -> np.ndarray:
    """Return the shares of the load below, above and far outside the data of a law."""
    return load_shares(answer.pressure[None], np.ones(answer.pressure.size), data_ends(law))


def checked(answer: Answer, law: NormalLaw) -> Answer:
    """Return an answer, or refuse it if more than 5 % of its load lies far outside the data."""
    far = float(shares_of(answer, law)[2, 0])
    if far > FAR_SHARE:
        low, high = law.pressure_range
        raise CaseError(
            f"{100.0 * far:.3g} % of the load of the structure lies more than a factor of "
            f"{FAR_FACTOR:g} outside the pressures of its cells, {1e-6 * low:.4g} to "
            f"{1e-6 * high:.4g} MPa: its answer is unknown; press the cells at these pressures"
        )
    return answer


def solve_concurrent(
    structure: Structure, seeds: Sequence[int], *, points_per_wave: int = 8
) -> Way:
    """Solve the structure with a cell at every point, once for each realisation."""
    begin = perf_counter()
    low, high = structure.pressures[[0, -1]]
    answers, solved, reused = [], 0, 0
    for seed in seeds:
        cell = structure.cell(structure.surface(seed, points_per_wave, CELL_WAVES))
        law = CellLaw(cell, (BELOW * low, high))
        answers.append(checked(structure.solve(law), law))
        solved += law.account["solved"]
        reused += law.account["reused"]
    seconds = perf_counter() - begin
    return Way(tuple(answers), seconds, seconds, solved, reused)


def solve_direct(structure: Structure, seeds: Sequence[int], *, points_per_wave: int = 8) -> Way:
    """Solve the structure with its roughness resolved, once for each realisation."""
    begin = perf_counter()
    answers = tuple(structure.resolve(seed, points_per_wave) for seed in seeds)
    seconds = perf_counter() - begin
    return Way(answers, seconds, seconds)


WAYS = {
    "sequential": solve_sequential,
    "adaptive": solve_adaptive,
    "concurrent": solve_concurrent,
    "direct": solve_direct,
}
SCENES = {"rough wave": RoughWave, "joint of two blocks": TiltedJoint}
EFFORTS = ((1 / 4, 8, 16), (1 / 8, 6, 16), (1 / 16, 4, 8), (1 / 32, 3, 8))
"""Ratios, structures, points per shortest wavelength of the truth: 4 times a power of 2."""


def measure(
    structure: Structure, seeds: range, finest: int, cells: int, points: int
) -> Iterator[dict[str, object]]:
    """Return a row for each way and grid with its error against the reference."""
    grids = [4 * 2**k for k in range(int(np.log2(finest / 4)) + 1)]
    direct = {n: solve_direct(structure, seeds, points_per_wave=n) for n in grids}
    coarser = {finest / n: direct[n].gaps for n in grids[:-1]}
    estimate = estimate_grid_error(direct[finest].gaps, coarser)
    truth = direct[finest].gaps - estimate.error
    law = solve_sequential(structure, range(cells), points_per_wave=points)
    concurrent = solve_concurrent(structure, seeds, points_per_wave=points)
    ways = [("sequential", law, law.seconds), ("sequential, law at hand", law, law.solve_seconds)]
    adapted = solve_adaptive(structure, range(cells), points_per_wave=points)
    ways += [("adaptive", adapted, adapted.seconds)]
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
        for way in WAYS.values():  # imports, compilation
            way(kind(0.25), [0], points_per_wave=3)
        for ratio, count, finest in [(1 / 4, 2, 8)] if arguments.quick else EFFORTS:
            numbers = (2, 4) if arguments.quick else (8, 8)  # cells, points per wave
            for row in measure(kind(ratio), range(count), finest, *numbers):
                rows.append({"scene": name, **row})
                sentence = (
                    f"{name}, 1/{round(1 / ratio)}, {row['method']}: error {row['error']:.2%}"
                )
                sys.stdout.write(f"{sentence}, {row['wall_time']:.3g} s\n")
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    result = WORK_PRECISION.build(columns, title="three ways to the mean gap of rough structures")
    write_dataset(result, out / "work_precision.nc", WORK_PRECISION)
    draw_work_precision(result, out / "work_precision.png")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

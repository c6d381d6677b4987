"""Structures with a rough interface, and the three ways to solve them."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any, ClassVar, NamedTuple

import numpy as np
from scipy.linalg import circulant
from scipy.sparse import csr_array, eye_array, hstack, kron, vstack

from multiscale.errors import CaseError, ConvergenceError
from multiscale.fe.boxes import plane_block
from multiscale.fe.elasticity import elastic_matrix
from multiscale.fe.faces import face_operator
from multiscale.laws import AreaLaw, NormalLaw
from multiscale.laws.bulk import Elastic
from multiscale.macro.continuum.body import Body, fixed_motion
from multiscale.macro.continuum.contact import Contact
from multiscale.macro.continuum.contact_steps import solve_contact
from multiscale.macro.continuum.finite_assembly import FiniteAssembly
from multiscale.macro.data_range import FAR_FACTOR, FAR_SHARE, data_ends, load_shares
from multiscale.macro.monolithic import solve_interface
from multiscale.micro import (
    FlatCell,
    Path,
    Surface,
    contact_modulus,
    run_ensemble,
    self_affine,
    solve_cell,
)
from multiscale.numerics.factorisation import on_diagonal
from multiscale.schema import Dataset
from multiscale.studies.cell_law import CellLaw
from multiscale.upscaling import area_from_dataset, fit_law, law_from_dataset

BAND = 4.0  # longest over shortest wavelength of the roughness
HURST_EXPONENT = 0.8
CELL_WAVES = 4
"""Longest wavelengths of the roughness along an edge of a cell."""
BELOW = 0.1
"""Lowest pressure of a cell at the points of a structure over the lowest of a law."""
STEEL = Elastic(210e9, 0.3)


class Answer(NamedTuple):
    """Averages over a structure, and the pressure along it."""

    mean_gap: float  # m
    contact_fraction: float  # NaN if unknown
    position: np.ndarray  # (points,), along the structure, m
    pressure: np.ndarray  # (points,), averaged across the structure, Pa


@dataclass(frozen=True)
class RoughStructure(ABC):
    r"""A structure of length :math:`\ell` with a self-affine interface.

    Parameters
    ----------
    ratio : float
        :math:`\varepsilon = \lambda_l / \ell \le 1/4`, longest wavelength of the roughness over the
        length of the structure; the inverse of a whole number. The band ends at
        :math:`\lambda_l / 4`.

    Attributes
    ----------
    length, rms_height : float, of the structure and of the roughness, m
    points : int, of the structure with a law
    areal : bool, whether the roughness varies in both directions, or is a profile

    Raises
    ------
    CaseError
        If the ratio is not the inverse of a whole number of at least 4.
    """

    length: ClassVar[float]
    rms_height: ClassVar[float]
    points: ClassVar[int]
    areal: ClassVar[bool] = True

    ratio: float

    def __post_init__(self) -> None:
        waves = 1.0 / self.ratio if self.ratio > 0.0 else 0.0
        if waves < 4.0 - 1e-9 or abs(waves - round(waves)) > 1e-9 * waves:
            raise CaseError(
                f"ratio must be the inverse of a whole number of at least 4, such as 1/8, got "
                f"{self.ratio:g}"
            )

    @property
    def waves(self) -> int:
        """Longest wavelengths of the roughness along the structure."""
        return round(1.0 / self.ratio)

    @property
    @abstractmethod
    def pressures(self) -> np.ndarray:
        """Mean pressures of cells, which cover the range of the structure, Pa."""

    @abstractmethod
    def cell(self, surface: Surface) -> FlatCell:
        """Build the cell under a piece of the roughness."""

    @abstractmethod
    def solve(self, law: NormalLaw, area: AreaLaw | None = None, *, refined: int = 1) -> Answer:
        """Solve the structure with a law of its roughness, on ``refined`` times its points."""

    @abstractmethod
    def resolve(self, seed: int, points_per_wave: int) -> Answer:
        """Solve the structure with all of its roughness, by points per shortest wavelength."""

    def surface(self, seed: int, points_per_wave: int, waves: int | None = None) -> Surface:
        """Return the roughness of a square piece, by its longest wavelengths along an edge.

        Of the whole structure, as for :meth:`resolve`, if the number is not given.
        """
        waves = self.waves if waves is None else waves
        n = round(BAND * points_per_wave * waves)
        edge = waves * self.ratio * self.length
        return self_affine(
            (n, n if self.areal else 1),
            (edge, edge if self.areal else edge / n),
            seed,
            hurst_exponent=HURST_EXPONENT,
            long_cutoff=self.ratio * self.length,
            short_cutoff=self.ratio * self.length / BAND,
            rms_height=self.rms_height,
        )


@dataclass(frozen=True)
class RoughWave(RoughStructure):
    r"""An elastic half-space with a rough wave, pressed against a rigid plane.

    The wave :math:`\Delta \cos(2\pi x/\lambda)` with :math:`\Delta = 0.01\,\lambda` carries the
    mean pressure :math:`p^*/2`, half of what closes it when smooth; the roughness has the root
    mean square height :math:`0.002\,\lambda` and wavelengths from :math:`\varepsilon\lambda` to
    :math:`\varepsilon\lambda/4`, Hurst exponent 0.8. Slopes count as small, however large, so the
    answers depend on ratios only.

    *Resolved*, it is a flat cell of one period with wave and roughness on it; *with a law*, a wave
    in plane strain. There the displacement of the surface is the change of the gap g up to a
    constant, so that with the stiffness K of :func:`half_space_stiffness` and the weights w

    .. math:: K (g - g_0) + w\,t(g) = -w\,p.    \tag{1}

    Attributes
    ----------
    amplitude : float, of the wave, m
    modulus, pressure : float, contact modulus and nominal pressure, Pa
    """

    length = 1e-3  # m
    rms_height = 2e-6  # m
    points = 256
    amplitude: ClassVar[float] = 1e-5
    modulus: ClassVar[float] = contact_modulus((STEEL.youngs_modulus, STEEL.poissons_ratio))
    pressure: ClassVar[float] = 0.5 * np.pi * modulus * amplitude / length

    @property
    def pressures(self) -> np.ndarray:
        """Mean pressures of cells, Pa: from the rim of the contact to beyond its crest."""
        return self.pressure * np.geomspace(0.05, 4.0, 10)

    def cell(self, surface: Surface) -> FlatCell:
        """Return a flat cell, deep enough for a half-space."""
        return FlatCell(surface, 2.0 * max(surface.size), 8, STEEL)

    def wave(self, points: int) -> tuple[np.ndarray, np.ndarray]:
        """Return positions and heights of the smooth wave, m."""
        x = self.length * np.arange(points) / points
        return x, self.amplitude * np.cos(2.0 * np.pi * x / self.length)

    def solve(self, law: NormalLaw, area: AreaLaw | None = None, *, refined: int = 1) -> Answer:
        """Solve the wave with a law of its roughness."""
        points = refined * self.points
        x, wave = self.wave(points)
        K = half_space_stiffness(points, self.length, self.modulus)
        weight = np.full(points, self.length / points)
        solution = solve_interface(
            K,
            K @ (self.amplitude - wave) - weight * self.pressure,  # (1)
            eye_array(points, format="csr"),
            weight,
            law,
            start=np.full(points, float(law.gap_at(np.array(self.pressure))) - law.gap),
            tolerance=1e-8,
        )
        g = solution.unwrap() + law.gap
        pressure = law.pressure(g)
        fraction = np.nan if area is None else float(np.mean(area.contact_fraction(pressure)))
        return Answer(float(np.mean(g)), fraction, x, pressure)

    def resolve(self, seed: int, points_per_wave: int) -> Answer:
        """Solve the wave with its roughness on it."""
        rough = self.surface(seed, points_per_wave)
        n = rough.heights.shape[0]
        x, wave = self.wave(n)
        surface = Surface(rough.heights + wave[:, None], rough.size)
        path = Path(pressure=(self.pressure,))
        response = solve_cell(self.cell(surface), path, keep_fields=True)
        if not response["converged"].values.all():
            raise ConvergenceError(
                f"the wave with its roughness resolved by {n} x {n} points did not converge; "
                f"lower points_per_wave"
            )
        step = response.isel(realisation=0, step=0)
        gap, fraction = float(step["mean_gap"]), float(step["contact_fraction"])
        return Answer(gap, fraction, x, step["pressure"].values.mean(axis=0))


def half_space_stiffness(points: int, length: float, contact_modulus: float) -> np.ndarray:
    r"""Return the surface stiffness of a half-space, periodic, in plane strain."""
    q = 2.0 * np.pi * np.abs(np.fft.fftfreq(points, length / points))
    return np.asarray(circulant(np.fft.ifft(0.5 * contact_modulus * q).real) * (length / points))


@dataclass(frozen=True)
class TiltedJoint(RoughStructure):
    r"""Two steel blocks in plane strain between platens; the upper platen comes down tilted.

    Each block is as wide as :math:`\ell` and half as high, and the origin is the middle of the
    interface. The platens hold the far faces; the upper platen comes down by

    .. math:: \delta(x) = \delta_0 \left(1 + a\,\frac{2x}{\ell}\right), \qquad
        \delta_0 = 10^{-3} \ell    \tag{1}

    from where the mean planes of the interface coincide. The pressure varies from a fifth to nine
    fifths of its mean, about :math:`10^{-3} E^*`. The profile of the composite roughness has the
    root mean square height :math:`2\cdot 10^{-4}\,\ell`.

    *Resolved*, the face of the upper block is meshed with the profile; *with a law*, both blocks
    are plane. Cells are profiles with the contact modulus of both blocks. Assemblies have three
    dimensions: the matrices are assembled here for :func:`solve_interface`.

    Attributes
    ----------
    bulk : Elastic, of both blocks
    tilt : float, :math:`a` of (1), dimensionless
    approach : float, mean of (1), m
    """

    length = 0.02  # m
    rms_height = 4e-6  # m
    points = 64  # elements along the interface
    areal = False
    bulk: ClassVar[Elastic] = STEEL
    tilt: ClassVar[float] = 0.8
    approach: ClassVar[float] = 1e-3 * length

    @property
    def moduli(self) -> tuple[float, float]:
        """Young's modulus, Pa, and Poisson's ratio."""
        return float(self.bulk.youngs_modulus), float(self.bulk.poissons_ratio)

    @property
    def pressures(self) -> np.ndarray:
        """Mean pressures of cells, Pa: from the light edge to beyond the heavy edge."""
        return 1e-3 * contact_modulus(self.moduli) * np.geomspace(0.03, 4.0, 12)

    def cell(self, surface: Surface) -> FlatCell:
        """Return a flat profile with the contact modulus of both blocks."""
        both = contact_modulus(self.moduli, self.moduli) * (1.0 - self.moduli[1] ** 2)
        return FlatCell(surface, 2.0 * max(surface.size), 8, Elastic(both, self.moduli[1]))

    def solve(self, law: NormalLaw, area: AreaLaw | None = None, *, refined: int = 1) -> Answer:
        """Solve the joint with a law of its roughness; layers grow away from the interface."""
        # stiffness of both blocks, and the motion of the platens
        bodies = self._bodies(np.zeros(refined * self.points))
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
        start = np.zeros(u.size)
        typical = self.approach / self.length * self.moduli[0]
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
        pressure = law.pressure(gap)
        local = np.full(gap.size, np.nan) if area is None else area.contact_fraction(pressure)
        mean = weight / weight.sum()
        return Answer(float(mean @ gap), float(mean @ local), position[0], pressure)

    def resolve(self, seed: int, points_per_wave: int) -> Answer:
        """Solve the joint with the profile on the face of the upper block."""
        return self.mesh_profile(self.surface(seed, points_per_wave).heights[:, 0])

    def mesh_profile(self, profile: np.ndarray) -> Answer:
        """Solve the joint with a periodic profile on the face of the upper block.

        Its heights, m, are at equidistant points from the left edge, positive into the lower block;
        every point is a node.
        """
        # the mesh starts clear of the lower block: the platen comes down by this much more
        lower, upper = self._bodies(profile, float(np.max(profile)))
        problem = FiniteAssembly(
            {"lower": lower, "upper": upper},
            {"interface": Contact(("upper", "face"), ("lower", "face"))},
        )
        step = solve_contact(problem, tolerance=1e-8)[-1].unwrap()
        face = step.contact["interface"]
        mean, closed = face.area / face.area.sum(), face.pressure > 0.0
        gap = float(mean @ face.gap)
        return Answer(gap, float(mean @ closed), face.position[0], face.pressure)

    def _bodies(self, profile: np.ndarray, lift: float = 0.0) -> tuple[Body, Body]:
        """Build the lower block, and the upper block with a profile, above by a lift, m."""
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


@dataclass(frozen=True, eq=False)
class StructureOutcome:
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
    structure: RoughStructure,
    seeds: Sequence[int],
    *,
    points_per_wave: int = 8,
    waves: int = CELL_WAVES,
) -> StructureOutcome:
    """Press cells, fit a law to all of them and solve the structure with it.

    Parameters
    ----------
    structure : RoughStructure
    seeds : sequence of int, of the cells
    points_per_wave, waves : int
        Grid points of the cells per shortest wavelength, and longest wavelengths along their edge.
    """
    begin = perf_counter()
    cells = [structure.cell(structure.surface(seed, points_per_wave, waves)) for seed in seeds]
    response: Dataset = run_ensemble(cells, Path(pressure=tuple(structure.pressures)))
    dataset = fit_law(response, n_samples=0)
    law, area = law_from_dataset(dataset), area_from_dataset(dataset)
    fitted = perf_counter()
    answer = checked(structure.solve(law, area), law)
    end = perf_counter()
    solved = int(response["converged"].sum())
    return StructureOutcome((answer,), end - begin, end - fitted, solved, 0, response)


def checked(answer: Answer, law: NormalLaw) -> Answer:
    """Return an answer, or refuse it if more than 5 % of its load lies far outside the data.

    Far is beyond a factor of 2 outside the pressures of its law.
    """
    even = np.ones(answer.pressure.size)
    far = float(load_shares(answer.pressure[None], even, data_ends(law))[2, 0])
    if far > FAR_SHARE:
        low, high = law.pressure_range
        raise CaseError(
            f"{100.0 * far:.3g} % of the load of the structure lies more than a factor of "
            f"{FAR_FACTOR:g} outside the pressures of its cells, {1e-6 * low:.4g} to "
            f"{1e-6 * high:.4g} MPa: its answer is unknown; press the cells at these pressures"
        )
    return answer


def solve_concurrent(
    structure: RoughStructure, seeds: Sequence[int], *, points_per_wave: int = 8
) -> StructureOutcome:
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
    return StructureOutcome(tuple(answers), seconds, seconds, solved, reused)


def solve_direct(
    structure: RoughStructure, seeds: Sequence[int], *, points_per_wave: int = 8
) -> StructureOutcome:
    """Solve the structure with its roughness resolved, once for each realisation."""
    begin = perf_counter()
    answers = tuple(structure.resolve(seed, points_per_wave) for seed in seeds)
    seconds = perf_counter() - begin
    return StructureOutcome(answers, seconds, seconds)

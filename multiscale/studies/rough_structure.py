"""Structures with a rough interface that can be solved in three ways, and those ways."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any, ClassVar

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws import AreaLaw, NormalLaw
from multiscale.macro.data_range import FAR_FACTOR, FAR_SHARE, data_ends, load_shares
from multiscale.micro import FlatCell, Path, Surface, run_ensemble, self_affine
from multiscale.schema import Dataset
from multiscale.studies.concurrent import CellLaw
from multiscale.upscaling import area_from_dataset, fit_law, law_from_dataset

__all__ = [
    "Answer",
    "RoughStructure",
    "StructureOutcome",
    "solve_concurrent",
    "solve_direct",
    "solve_sequential",
]

BAND = 4.0  # longest over shortest wave of the roughness
HURST_EXPONENT = 0.8
CELL_WAVES = 4
"""Longest waves of the roughness along an edge of a cell."""

BELOW = 0.1
"""Lowest pressure of a cell at the points of a structure over the lowest of a law."""


@dataclass(frozen=True, eq=False)
class Answer:
    """Interface of a structure that has been solved.

    Attributes
    ----------
    mean_gap : float, mean over the nominal area, m
    contact_fraction : float, real over nominal area; NaN if nothing tells it
    position, pressure : ndarray, shape (points,)
        Along the structure, m, and the pressure there, averaged across it, Pa.
    """

    mean_gap: float
    contact_fraction: float
    position: np.ndarray
    pressure: np.ndarray


@dataclass(frozen=True)
class RoughStructure(ABC):
    r"""A structure of length :math:`\ell` with a self-affine interface.

    Parameters
    ----------
    ratio : float
        :math:`\varepsilon = \lambda_l / \ell \le 1/4`, longest wave of the roughness over the
        length of the structure; one over a whole number. The band ends at :math:`\lambda_l / 4`.

    Attributes
    ----------
    length, rms_height : float, of the structure and of the roughness, m
    points : int, of the structure with a law
    areal : bool, whether the roughness varies in both directions, or is of a profile

    Raises
    ------
    CaseError
        If the ratio is not one over a whole number of at least 4.
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
                f"ratio must be one over a whole number of at least 4, such as 1/8, got "
                f"{self.ratio:g}"
            )

    @property
    def waves(self) -> int:
        """Longest waves of the roughness along the structure."""
        return round(1.0 / self.ratio)

    @property
    @abstractmethod
    def pressures(self) -> np.ndarray:
        """Mean pressures at which cells tell what the structure needs, Pa."""

    @abstractmethod
    def cell(self, surface: Surface) -> FlatCell:
        """Cell under a piece of the roughness."""

    @abstractmethod
    def solve(self, law: NormalLaw, area: AreaLaw | None = None, *, refined: int = 1) -> Answer:
        """Solve the structure with a law of its roughness, on so many times its points."""

    @abstractmethod
    def resolve(self, seed: int, points_per_wave: int) -> Answer:
        """Solve the structure with all of its roughness, by points per shortest wave."""

    def surface(self, seed: int, points_per_wave: int, waves: int | None = None) -> Surface:
        """Roughness of a square piece, by its longest waves along an edge.

        The whole structure, if the number of waves is not given: what :meth:`resolve` resolves.
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


@dataclass(frozen=True, eq=False)
class StructureOutcome:
    """What one way to the answer found and took.

    Attributes
    ----------
    answers : tuple of Answer, of every realisation, or the one of all of them together
    seconds : float, wall time of all, s
    solve_seconds : float
        Of the structure alone, its law at hand, s; for the other ways the same as ``seconds``.
    solved, reused : int
        Cells solved (one at each load step), and how often a cell solved before served again.
    response : Dataset, follows ``MICRO_RESPONSE``; of the sequential way alone
    """

    answers: tuple[Answer, ...]
    seconds: float
    solve_seconds: float
    solved: int = 0
    reused: int = 0
    response: Any = None

    @property
    def mean_gap(self) -> float:
        """Mean over the realisations, m."""
        return float(np.mean(self.gaps))

    @property
    def gaps(self) -> np.ndarray:
        """Mean gap of every answer, m."""
        return np.array([answer.mean_gap for answer in self.answers])


def solve_sequential(
    structure: RoughStructure,
    seeds: Sequence[int],
    *,
    points_per_wave: int = 8,
    waves: int = CELL_WAVES,
) -> StructureOutcome:
    """Press cells, fit one law to all of them and solve the structure with it.

    Parameters
    ----------
    structure : RoughStructure
    seeds : sequence of int, of the cells
    points_per_wave, waves : int
        Grid points of the cells per shortest wave, and longest waves along an edge of a cell.
    """
    begin = perf_counter()
    cells = [structure.cell(structure.surface(seed, points_per_wave, waves)) for seed in seeds]
    response = run_ensemble(cells, Path(pressure=tuple(structure.pressures)))
    law, area = laws_of(response)
    fitted = perf_counter()
    answer = checked(structure.solve(law, area), law)
    end = perf_counter()
    solved = int(response["converged"].sum())
    return StructureOutcome((answer,), end - begin, end - fitted, solved, 0, response)


def laws_of(response: Dataset) -> tuple[NormalLaw, AreaLaw]:
    """Law of the pressure and of the contact area that a response gives."""
    law = fit_law(response, n_samples=0)
    return law_from_dataset(law), area_from_dataset(law)


def answer_of(structure: RoughStructure, response: Dataset, refined: int = 1) -> Answer:
    """Answer of the structure with the law of a response."""
    law, area = laws_of(response)
    return checked(structure.solve(law, area, refined=refined), law)


def checked(answer: Answer, law: NormalLaw) -> Answer:
    """Refuse an answer that rests on pressures far outside the data of its law, by a ``CaseError``.

    That is where more than 5 % of the load lies beyond a factor of 2 outside.
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

"""Two-scale fatigue: damage below the yield stress, from cycles of a weak micro-inclusion."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter

import numpy as np

from multiscale.errors import CaseError
from multiscale.micro.damage.cycle_jump import FatigueProgress, pass_cycles
from multiscale.micro.damage.fatigue_material import STATE_SIZE, FatigueMaterial, StressBlock
from multiscale.schema import FATIGUE, WOEHLER, Dataset

__all__ = ["two_scale_fatigue", "woehler_curve"]


def two_scale_fatigue(
    history: np.ndarray | StressBlock | Sequence[float] | Sequence[StressBlock],
    material: FatigueMaterial,
    *,
    jump_tolerance: float | None = 0.02,
    max_cycles: float = 1e9,
    substeps: int = 16,
) -> Dataset:
    """Compute damage under a stress history until a crack starts or the inclusion stays elastic.

    Parameters
    ----------
    history : ndarray, sequence of float, StressBlock or sequence of StressBlock
        Macro stress, Pa: one cycle, see :class:`StressBlock`, repeated without end; or a sequence
        of blocks, which is repeated as a whole.
    material : FatigueMaterial
    jump_tolerance : float, optional
        Bound on the relative difference between the change over a jump of cycles extrapolated
        from its start and from both its ends; the second, better value is kept. None computes
        every cycle.
    max_cycles : float
    substeps : int
        Steps for the plastic part of each straight piece. The flow is exact in one step; the
        errors of the feedback of damage and of the damage law are of second order in the steps.

    Returns
    -------
    Dataset
        Follows ``FATIGUE``: damage and plastic strain of the inclusion against cycles, and the
        numbers of cycles to initiation of damage and to rupture. The numbers are infinite if the
        inclusion stays or becomes elastic (``run_out`` 1), and NaN if ``max_cycles`` was reached
        before (``converged`` 0).

    Raises
    ------
    CaseError
        If an option is out of range.

    Examples
    --------
    >>> steel = FatigueMaterial(200e9, 0.3, 200e6, 0.5e6, threshold=0.05, feedback=False)
    >>> life = two_scale_fatigue(np.array([210e6, -210e6]), steel)
    >>> round(float(life["cycles_to_rupture"]))
    4684
    """
    if jump_tolerance is not None and not 0.0 < jump_tolerance < 1.0:
        raise CaseError(f"jump_tolerance must lie between 0 and 1, got {jump_tolerance:g}")
    if not max_cycles >= 1.0 or substeps < 1:
        raise CaseError(
            f"max_cycles and substeps must be at least 1, got {max_cycles:g} and {substeps}"
        )
    begin = perf_counter()
    parts = history if isinstance(history, Sequence) else [history]
    program = [part for part in parts if isinstance(part, StressBlock)]
    if len(program) < len(parts):  # a single path is one block
        try:
            program = [StressBlock(np.asarray(history, dtype=float))]
        except (TypeError, ValueError) as error:
            raise CaseError(
                f"a history is one path of numbers or a list of StressBlocks, got {history!r}"
            ) from error
    if not program:
        raise CaseError("the history holds no block; give at least one")
    life = _Life(program, material, jump_tolerance, substeps)
    run, record = life.compute(max_cycles)
    broken, elastic = bool(run.broken[0]), bool(run.elastic[0])
    ended = broken or elastic
    rupture = float(run.cycles[0]) if broken else np.inf if elastic else np.nan
    cycles, damage, strain = np.array(record).T
    initiation = np.inf if ended else np.nan
    if strain[-1] > material.threshold:
        after = int(np.argmax(strain > material.threshold))
        part = slice(after - 1, after + 1)
        initiation = float(np.interp(material.threshold, strain[part], cycles[part]))
    return FATIGUE.build(
        {
            "cycles": cycles,
            "damage": damage,
            "plastic_strain": strain,
            "cycles_to_initiation": initiation,
            "cycles_to_rupture": rupture,
            "run_out": int(elastic),
            "computed_cycles": float(run.computed[0]),
            "converged": int(ended),
            "wall_time": perf_counter() - begin,
        }
    )


def woehler_curve(
    material: FatigueMaterial,
    amplitudes: np.ndarray,
    *,
    stress_ratio: float = -1.0,
    direction: np.ndarray | None = None,
    jump_tolerance: float | None = 0.02,
) -> Dataset:
    """Compute the lives at constant amplitudes.

    Parameters
    ----------
    material : FatigueMaterial
    amplitudes : ndarray, shape (steps,), half the range of stress, Pa
    stress_ratio : float, smallest over largest stress, below 1; -1 for reversed loading
    direction : ndarray, shape (6,), optional
        Stress per unit of amplitude, dimensionless; uniaxial if not given.
    jump_tolerance : float, optional
        See :func:`two_scale_fatigue`.

    Returns
    -------
    Dataset
        Follows ``WOEHLER``.

    Raises
    ------
    CaseError
        If an amplitude is not positive or the ratio not below 1.
    """
    amplitudes = np.asarray(amplitudes, dtype=float)
    if amplitudes.ndim != 1 or not np.all((amplitudes > 0.0) & np.isfinite(amplitudes)):
        raise CaseError(f"amplitudes must be positive (Pa), got {amplitudes}")
    if not stress_ratio < 1.0:
        raise CaseError(f"stress_ratio must be below 1, got {stress_ratio:g}")
    along = np.eye(6)[0] if direction is None else np.asarray(direction, dtype=float)
    lives = []
    for amplitude in amplitudes:
        largest = 2.0 * amplitude / (1.0 - stress_ratio)
        path = np.array([largest, stress_ratio * largest])[:, None] * along
        lives.append(two_scale_fatigue(path, material, jump_tolerance=jump_tolerance))
    names = ("cycles_to_initiation", "cycles_to_rupture", "run_out", "converged", "wall_time")
    values = {name: np.array([life[name].item() for life in lives]) for name in names}
    return WOEHLER.build({"amplitude": amplitudes, **values}, stress_ratio=stress_ratio)


@dataclass(frozen=True)
class _Life:
    """Computation of a fatigue life: blocks that are repeated as a whole, and options."""

    program: list[StressBlock]
    material: FatigueMaterial
    tolerance: float | None
    substeps: int

    def compute(
        self, max_cycles: float
    ) -> tuple[FatigueProgress, list[tuple[float, float, float]]]:
        """Repeat the blocks until rupture, shakedown or the last cycle."""
        run, record = FatigueProgress.begin(np.zeros((1, STATE_SIZE))), [(0.0, 0.0, 0.0)]

        def note() -> None:
            record.append((float(run.cycles[0]), float(run.state[0, 0]), float(run.state[0, 1])))

        alone = len(self.program) == 1
        length = 1 if alone else sum(block.cycles for block in self.program)
        left = int(max(1, max_cycles // length))
        if self.tolerance is not None:
            once = partial(self.pass_block, self.program[0], 1) if alone else self.pass_program
            pass_cycles(run, once, left, self.material, self.tolerance, note)
            return run, record
        while left > 0 and not (run.broken[0] or run.elastic[0]):
            many = min(left, max(1, int(run.cycles[0]) // (20 * length)))  # passes for each record
            if alone:
                self.pass_block(self.program[0], many, run)
            else:
                for _ in range(many):
                    self.pass_program(run)
                    if run.broken[0] or run.elastic[0]:
                        break
            left -= many
            note()
        return run, record

    def pass_block(self, block: StressBlock, cycles: int, run: FatigueProgress) -> None:
        """Compute every cycle of a block."""
        from multiscale.micro.damage.inclusion import run_points

        path, kind, first = block.stress[None], self.material.parameters()[None], run.number
        done, run.elastic[:] = run_points(
            run.state, path, first, cycles, kind, first, self.substeps
        )
        run.cycles += done
        run.computed += done
        run.broken[:] = run.state[:, 0] >= self.material.critical_damage

    def pass_program(self, run: FatigueProgress) -> None:
        """Pass through all blocks."""
        strain = run.state[:, 1].copy()
        for block in self.program:
            start = run.cycles.copy()
            if self.tolerance is None:
                self.pass_block(block, block.cycles, run)
            else:
                once = partial(self.pass_block, block, 1)
                run.elastic[:] = False
                pass_cycles(run, once, block.cycles, self.material, self.tolerance)
            if run.broken[0]:
                return
            if run.elastic[0]:  # the remaining cycles only count
                run.cycles[:] = start + block.cycles
        run.elastic[:] = run.state[:, 1] == strain

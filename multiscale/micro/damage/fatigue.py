"""Two-scale fatigue: damage below the yield stress, from cycles of a weak micro-inclusion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.schema import FATIGUE, WOEHLER

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["Block", "FatigueMaterial", "two_scale_fatigue", "woehler_curve"]

JUMP_GROWTH = 4.0
"""Largest ratio of a jump to the one before."""

FEWEST = 4
"""Jumps over fewer cycles than this are not worth their two trial cycles."""


@dataclass(frozen=True)
class FatigueMaterial:
    r"""Elastic volume and micro-inclusion; see :mod:`~multiscale.micro.damage.inclusion`.

    Parameters
    ----------
    youngs_modulus, poissons_ratio : float
        Of both, Pa and dimensionless.
    fatigue_limit : float
        :math:`\sigma_f`, at which the inclusion yields, Pa.
    damage_strength : float
        :math:`S` of the damage law, Pa.
    damage_exponent : float
        :math:`s`, dimensionless.
    hardening : float
        Kinematic modulus :math:`C`, Pa.
    threshold : float
        Plastic strain :math:`p_D` of the inclusion at which damage sets in.
    critical_damage : float
        :math:`D_c` at which a crack starts.
    closure : float
        :math:`h`: share of the damage that acts in compression, 0 to 1.
    feedback : bool
        Whether damage changes the stress of the inclusion. Without it the model has a closed
        form for reversed tension.

    Raises
    ------
    CaseError
        If a parameter is outside its range.
    """

    youngs_modulus: float
    poissons_ratio: float
    fatigue_limit: float
    damage_strength: float
    damage_exponent: float = 1.0
    hardening: float = 0.0
    threshold: float = 0.0
    critical_damage: float = 0.3
    closure: float = 1.0
    feedback: bool = True

    def __post_init__(self) -> None:
        for name, unit in (
            ("youngs_modulus", "Pa"),
            ("fatigue_limit", "Pa"),
            ("damage_strength", "Pa"),
            ("damage_exponent", "dimensionless"),
        ):
            value = getattr(self, name)
            if not (value > 0.0 and np.isfinite(value)):
                raise CaseError(f"{name} must be positive ({unit}), got {value:g}")
        for name, unit in (("hardening", "Pa"), ("threshold", "dimensionless")):
            value = getattr(self, name)
            if not (value >= 0.0 and np.isfinite(value)):
                raise CaseError(f"{name} must not be negative ({unit}), got {value:g}")
        if not -1.0 < self.poissons_ratio < 0.5:
            raise CaseError(
                f"poissons_ratio must lie between -1 and 0.5, got {self.poissons_ratio:g}"
            )
        if not 0.0 < self.critical_damage <= 1.0:
            raise CaseError(
                f"critical_damage must lie above 0 and up to 1, got {self.critical_damage:g}"
            )
        if not 0.0 <= self.closure <= 1.0:
            raise CaseError(f"closure must lie from 0 to 1, got {self.closure:g}")

    def parameters(self) -> np.ndarray:
        """All parameters in the order of the kernel."""
        order = (
            "youngs_modulus",
            "poissons_ratio",
            "fatigue_limit",
            "hardening",
            "damage_strength",
            "damage_exponent",
            "threshold",
            "critical_damage",
            "closure",
            "feedback",
        )
        assert len(order) == len(fields(self))
        return np.array([float(getattr(self, name)) for name in order])


@dataclass(frozen=True)
class Block:
    """A stress path that is gone through many times.

    Parameters
    ----------
    stress : ndarray, shape (points,) or (points, 6)
        Corners of one cycle, joined by straight lines, Pa: uniaxial stress, or xx, yy, zz, yz,
        xz, xy.
    cycles : int
        Number of cycles.

    Raises
    ------
    CaseError
        If a stress is not finite or there are no cycles.
    """

    stress: np.ndarray
    cycles: int = 1

    def __post_init__(self) -> None:
        stress = np.asarray(self.stress, dtype=float)
        if stress.ndim == 1:
            stress = stress[:, None] * np.eye(6)[0]
        if stress.ndim != 2 or stress.shape[1] != 6 or len(stress) == 0:
            raise CaseError(
                f"the stress of a block needs the shape (points,) or (points, 6), "
                f"got {np.shape(self.stress)}"
            )
        if not np.all(np.isfinite(stress)):
            raise CaseError("the stress of a block must be finite (Pa)")
        if self.cycles < 1:
            raise CaseError(f"a block needs at least one cycle, got {self.cycles}")
        object.__setattr__(self, "stress", np.ascontiguousarray(stress))


@dataclass
class _Run:
    """What happens over the life; the only thing here that changes."""

    state: np.ndarray
    cycles: float = 0.0
    computed: float = 0.0  # cycles whose stress path was followed
    initiation: float = np.inf
    broken: bool = False
    elastic: bool = False


Pass = Callable[[_Run], None]


def two_scale_fatigue(
    history: np.ndarray | Block | Sequence[Block],
    material: FatigueMaterial,
    *,
    jump_tolerance: float | None = 0.02,
    max_cycles: float = 1e9,
    substeps: int = 16,
) -> "xr.Dataset":
    """Let damage grow under a stress history until a crack starts or nothing more happens.

    Parameters
    ----------
    history : ndarray, Block or sequence of Block
        Macro stress: one cycle, see :class:`Block`, repeated for ever; or blocks one after the
        other, which are repeated as a whole.
    material : FatigueMaterial
        Volume and inclusion.
    jump_tolerance : float, optional
        Cycles are jumped while the change over a jump, extrapolated from its start and from both
        its ends, differs by no more than this share; what is kept is the better of the two. None
        follows every cycle.
    max_cycles : float
        Where the run ends at the latest.
    substeps : int
        Steps for the plastic part of each straight piece. One is exact while the stress keeps
        its direction and the energy of damage is quadratic in it.

    Returns
    -------
    Dataset
        Follows ``FATIGUE``: damage and plastic strain of the inclusion against cycles, and the
        numbers of cycles to initiation of damage and to rupture. They are infinite if the
        inclusion stays or becomes elastic (``run_out`` 1), and NaN if ``max_cycles`` came first
        (``converged`` 0).

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
    blocks = [history] if isinstance(history, Block) else history
    program = (
        [Block(blocks, 1)]
        if isinstance(blocks, np.ndarray)
        else [block if isinstance(block, Block) else Block(block) for block in blocks]
    )
    if not program:
        raise CaseError("the history holds no block; give at least one")
    run, record = _follow(program, material, jump_tolerance, max_cycles, substeps)
    ended = run.broken or run.elastic
    rupture = run.cycles if run.broken else np.inf if run.elastic else np.nan
    initiation = run.initiation if np.isfinite(run.initiation) or ended else np.nan
    cycles, damage, strain = np.array(record).T
    return FATIGUE.build(
        {
            "cycles": cycles,
            "damage": damage,
            "plastic_strain": strain,
            "cycles_to_initiation": initiation,
            "cycles_to_rupture": rupture,
            "run_out": int(run.elastic),
            "computed_cycles": run.computed,
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
) -> "xr.Dataset":
    """Lives at constant amplitudes.

    Parameters
    ----------
    material : FatigueMaterial
        Volume and inclusion.
    amplitudes : ndarray, shape (steps,)
        Half the range of stress, Pa.
    stress_ratio : float
        Smallest over largest stress, below 1; -1 is reversed.
    direction : ndarray, shape (6,), optional
        Stress per unit of amplitude; uniaxial if not given.
    jump_tolerance : float, optional
        As in :func:`two_scale_fatigue`.

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


def _follow(
    program: list[Block],
    material: FatigueMaterial,
    tolerance: float | None,
    max_cycles: float,
    substeps: int,
) -> tuple[_Run, list[tuple[float, float, float]]]:
    """Repeat the blocks until rupture, shakedown or the last cycle."""
    from multiscale.micro.damage.inclusion import SIZE, run_cycles

    parameters = material.parameters()
    run = _Run(np.zeros(SIZE))
    record = [(0.0, 0.0, 0.0)]

    def note() -> None:
        if run.state[1] > material.threshold and np.isinf(run.initiation):
            run.initiation = _initiation(run, record[-1], material.threshold)
        record.append((run.cycles, float(run.state[0]), float(run.state[1])))

    def go(run: _Run, block: Block, cycles: int) -> None:
        done, run.elastic = run_cycles(run.state, block.stress, cycles, parameters, substeps)
        run.cycles += done
        run.computed += done
        run.broken = bool(run.state[0] >= material.critical_damage)

    def through_block(block: Block) -> Pass:
        def once(run: _Run) -> None:
            go(run, block, 1)

        def whole(run: _Run) -> None:
            start = run.cycles
            if tolerance is None:
                go(run, block, block.cycles)
            else:
                _advance(run, once, block.cycles, material, tolerance, lambda: None)
            if run.elastic:  # the cycles left change nothing but their number
                run.cycles, run.elastic = start + block.cycles, False

        return whole

    def through_program(run: _Run) -> None:
        strain = run.state[1]
        for block in program:
            through_block(block)(run)
            if run.broken:
                return
        run.elastic = bool(run.state[1] == strain)

    alone = len(program) == 1
    if alone:
        length, one = 1, lambda run: go(run, program[0], 1)
    else:
        length, one = sum(block.cycles for block in program), through_program
    left = int(max(1, max_cycles // length))
    if tolerance is not None:
        _advance(run, one, left, material, tolerance, note)
        return run, record
    while left > 0 and not (run.broken or run.elastic):
        many = min(left, max(1, int(run.cycles) // (20 * length)))
        if alone:
            go(run, program[0], many)
        else:
            for _ in range(many):
                through_program(run)
                if run.broken or run.elastic:
                    break
        left -= many
        note()
    return run, record


def _advance(
    run: _Run,
    once: Pass,
    count: int,
    material: FatigueMaterial,
    tolerance: float,
    note: Callable[[], None],
) -> None:
    r"""Pass ``count`` times, with jumps whose error is under control.

    Slow are damage, accumulated plastic strain and the drift :math:`X - \tfrac23 C (1-D)
    \varepsilon^p` of the back stress; let :math:`y` be they after a pass that changed them by
    :math:`d_1`. A trial pass from :math:`y + J d_1` brings the plastic strain, which is fast and
    not extrapolated, to its cycle there; a second one from the same :math:`y + J d_1` changes it
    by :math:`d_2`. The jump over J passes is accepted if :math:`|d_2 - d_1| / 2` is at most the
    tolerance times the larger of both, in damage and in accumulated strain, and takes the state to
    :math:`y + J (d_1 + d_2)/2`.
    """
    jump, done = float(FEWEST), 0
    while done < count:
        before, start = _slow(run.state, material), run.cycles
        once(run)
        done += 1
        note()
        if run.broken or run.elastic:
            return
        y, length = _slow(run.state, material), run.cycles - start
        first = y - before
        while True:
            J = int(min(jump, count - done, _longest(run.state, first, material)))
            if J < FEWEST:
                jump = max(jump, float(FEWEST))
                break
            trial = _Run(run.state.copy(), run.cycles)
            for _ in range(2):
                _set_slow(trial.state, y + J * first, material)
                once(trial)
            run.computed += trial.computed
            second = _slow(trial.state, material) - y - J * first
            change = _change(first, second)
            ahead = y + 0.5 * J * (first + second)
            if trial.broken or change > tolerance or ahead[0] >= material.critical_damage:
                jump = 0.5 * J if trial.broken else J * max(0.2, 0.8 * tolerance / change)
                continue
            run.state[:] = trial.state
            _set_slow(run.state, ahead, material)
            run.cycles += J * length
            done += J
            note()
            jump = J * min(JUMP_GROWTH, 0.8 * tolerance / max(change, 1e-300))
            break


def _change(first: np.ndarray, second: np.ndarray) -> float:
    """Half the relative difference of two changes, the larger of damage and plastic strain."""
    size = np.maximum(np.abs(first), np.abs(second))[:2]
    return float(np.max(0.5 * np.abs(second - first)[:2] / np.where(size > 0.0, size, 1.0)))


def _slow(state: np.ndarray, material: FatigueMaterial) -> np.ndarray:
    """Damage, accumulated plastic strain and drift of the back stress, shape (8,)."""
    modulus = 2.0 / 3.0 * material.hardening * (1.0 - state[0] * material.feedback)
    return np.concatenate([state[:2], state[8:14] - modulus * state[2:8]])


def _set_slow(state: np.ndarray, slow: np.ndarray, material: FatigueMaterial) -> None:
    """Put slow variables into a state whose plastic strain stays."""
    modulus = 2.0 / 3.0 * material.hardening * (1.0 - slow[0] * material.feedback)
    state[:2], state[8:14] = slow[:2], slow[2:] + modulus * state[2:8]


def _longest(state: np.ndarray, change: np.ndarray, material: FatigueMaterial) -> float:
    """Count the passes that may be jumped before the threshold or the critical damage."""
    if state[1] < material.threshold:
        return float((material.threshold - state[1]) // change[1] - 1.0) if change[1] else np.inf
    left = material.critical_damage - state[0]
    return float(left // change[0]) if change[0] > 0.0 else np.inf


def _initiation(run: _Run, last: tuple[float, float, float], threshold: float) -> float:
    """Cycles at which the plastic strain reached the threshold, between two records."""
    cycles, _, strain = last
    share = (threshold - strain) / (float(run.state[1]) - strain)
    return cycles + share * (run.cycles - cycles)

"""Two-scale fatigue: lives of weak micro-inclusions under repeated cycles of stress."""

from collections.abc import Callable
from dataclasses import astuple, dataclass, fields, replace
from time import perf_counter
from typing import Self

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.schema import FATIGUE, WOEHLER, Dataset

STATE_SIZE = 20
"""Length of the state: D, p, plastic strain (6), back stress (6, Pa), last macro stress (6, Pa)."""

STRAIGHT = 1e-6
"""Distance of a corner from the line of its neighbours, relative to the largest stress, below which
it is zero."""

LARGEST_GROWTH = 4.0  # largest ratio of a jump to the jump before
SHORTEST_JUMP = 4  # cycles of the shortest jump that saves more than its two trial cycles
RECORD_SHARE = 20  # records per number of cycles, without jumps


Note = Callable[["FatigueProgress"], None]


@dataclass(frozen=True)
class FatigueMaterial:
    r"""Elastic volume and micro-inclusion; see :mod:`~multiscale.micro.damage.inclusion`.

    Parameters
    ----------
    youngs_modulus, poissons_ratio : float, moduli of volume and inclusion, Pa and dimensionless
    fatigue_limit : float, :math:`\sigma_f`, yield stress of the inclusion, Pa
    damage_strength : float, :math:`S` of the damage law, Pa
    damage_exponent : float, :math:`s`, dimensionless
    hardening : float, kinematic modulus :math:`C`, Pa
    threshold : float
        Plastic strain :math:`p_D` of the inclusion at which damage begins, dimensionless.
    critical_damage : float, :math:`D_c` at which a crack starts, dimensionless, above 0 and up to 1
    closure : float, :math:`h`, share of the damage that acts in compression, 0 to 1
    feedback : bool
        Whether damage changes the stress of the inclusion. Without it the model has a closed
        form for reversed tension.
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
            require(name, value, "(0, inf)", unit)
        for name, unit in (("hardening", "Pa"), ("threshold", "dimensionless")):
            value = getattr(self, name)
            require(name, value, "[0, inf)", unit)
        require("poissons_ratio", self.poissons_ratio, "(-1, 0.5)")
        require("critical_damage", self.critical_damage, "(0, 1]")
        require("closure", self.closure, "[0, 1]")

    def parameters(self) -> np.ndarray:
        """Return the parameters in SI units, in the order of the fields and of the kernel."""
        return np.array(astuple(self), dtype=float)


@dataclass
class FatigueProgress:
    """Progress of the fatigue lives of some inclusions, changed in place with every pass."""

    state: np.ndarray  # (points, 20), state of each inclusion
    number: np.ndarray  # (points,), index of each inclusion among all
    cycles: np.ndarray  # (points,), completed cycles, with jumps
    computed: np.ndarray  # (points,), computed cycles, without jumps
    broken: np.ndarray  # (points,), whether the critical damage was reached
    elastic: np.ndarray  # (points,), whether an inclusion stays elastic from now on

    @classmethod
    def begin(cls, state: np.ndarray) -> Self:
        """Begin at given states, shape (points, 20), with zero cycles."""
        n = len(state)
        zeros, no = np.zeros((2, n)), np.zeros((2, n), dtype=bool)
        return cls(state.copy(), np.arange(n), *zeros, *no)

    def take(self, index: np.ndarray) -> Self:
        """Copy the progress of selected inclusions."""
        return type(self)(*(getattr(self, field.name)[index] for field in fields(self)))

    def put(self, index: np.ndarray, selected: "FatigueProgress") -> None:
        """Write the progress of selected inclusions."""
        for field in fields(self):
            getattr(self, field.name)[index] = getattr(selected, field.name)


def _slow_variables(state: np.ndarray, material: FatigueMaterial) -> np.ndarray:
    """Return damage, accumulated plastic strain and drift of the back stress, (points, 8)."""
    modulus = 2.0 / 3.0 * material.hardening * (1.0 - state[:, :1] * material.feedback)
    return np.concatenate([state[:, :2], state[:, 8:14] - modulus * state[:, 2:8]], axis=1)


def _set_slow_variables(state: np.ndarray, slow: np.ndarray, material: FatigueMaterial) -> None:
    modulus = 2.0 / 3.0 * material.hardening * (1.0 - slow[:, :1] * material.feedback)
    state[:, :2], state[:, 8:14] = slow[:, :2], slow[:, 2:] + modulus * state[:, 2:8]


def _longest(state: np.ndarray, change: np.ndarray, material: FatigueMaterial) -> np.ndarray:
    """Count the passes that a jump may skip before the threshold or the critical damage."""
    sound = state[:, 1] < material.threshold
    left = np.where(sound, material.threshold - state[:, 1], material.critical_damage - state[:, 0])
    rate = np.where(sound, change[:, 1], change[:, 0])
    passes = left // np.where(rate > 0.0, rate, 1.0) - sound
    return np.asarray(np.where(rate > 0.0, passes, np.inf))


@dataclass(frozen=True, eq=False)
class Inclusions:
    """Inclusions of elements, in classes of fatigue limits: ``e * classes + k`` is class k."""

    material: FatigueMaterial
    factors: np.ndarray  # (classes,), fatigue limits over the limit of the material
    tolerance: float | None = 0.02  # tolerance of the jumps; None computes every cycle
    substeps: int = 16  # of the plastic range of each straight segment of a path

    def follow(
        self,
        state: np.ndarray,
        stress: np.ndarray,
        cycles: int,
        note: Note = lambda run: None,
    ) -> FatigueProgress:
        """Repeat a cycle of stress, (corners, elements, 6), from states (points, 20)."""
        from multiscale.micro.damage.inclusion import run_points

        path, n = np.ascontiguousarray(_bends(stress).swapaxes(0, 1)), self.factors.size
        limits = self.material.fatigue_limit * self.factors
        kinds = np.array(
            [replace(self.material, fatigue_limit=limit).parameters() for limit in limits]
        )
        run = FatigueProgress.begin(state)
        run.broken[:] = state[:, 0] >= self.material.critical_damage

        def compute(selected: FatigueProgress, count: int) -> None:
            element, kind = np.divmod(selected.number, n)
            done, selected.elastic[:] = run_points(
                selected.state, path, element, count, kinds, kind, self.substeps
            )
            selected.cycles += done
            selected.computed += done
            selected.broken[:] = selected.state[:, 0] >= self.material.critical_damage

        if self.tolerance is not None:
            self.pass_cycles(run, compute, cycles, note)
            return run
        done = 0
        while done < cycles and (going := np.flatnonzero(~(run.broken | run.elastic))).size:
            count, selected = min(cycles - done, max(1, done // RECORD_SHARE)), run.take(going)
            compute(selected, count)
            run.put(going, selected)
            done += count
            note(run)
        return run

    def pass_cycles(
        self,
        run: FatigueProgress,
        compute: Callable[[FatigueProgress, int], None],
        count: int,
        note: Note,
    ) -> None:
        """Compute ``count`` cycles, with jumps under an error control."""
        assert self.tolerance is not None
        # Slow variables y are damage, accumulated strain and the drift X - 2/3 C (1-D) eps_p of the
        # back stress. Of two trial passes from y + J d_1 the first brings the plastic strain, which
        # is fast, to its cycle there; with the change d_2 of the second, y + J (d_1 + d_2)/2 is
        # accepted if |d_2 - d_1|/2 is at most the tolerance times the larger change, in damage and
        # in accumulated strain.
        jump, done = np.full(len(run.state), float(SHORTEST_JUMP)), np.zeros(len(run.state))

        def going() -> np.ndarray:
            return np.flatnonzero(~(run.broken | run.elastic) & (done < count))

        while (passing := going()).size:
            # a pass, which changes the slow variables by d_1
            selected = run.take(passing)
            before, start = _slow_variables(selected.state, self.material), selected.cycles.copy()
            compute(selected, 1)
            run.put(passing, selected)
            done[passing] += 1
            note(run)
            y = _slow_variables(selected.state, self.material)
            first, length = y - before, selected.cycles - start
            at = np.flatnonzero(np.isin(passing, going()))  # positions in ``passing``
            while at.size:
                # length of the jump
                all_at = passing[at]
                J = np.minimum(jump[all_at], count - done[all_at])
                J = np.floor(np.minimum(J, _longest(selected.state[at], first[at], self.material)))
                short = J < SHORTEST_JUMP
                jump[all_at[short]] = np.maximum(jump[all_at[short]], SHORTEST_JUMP)
                at, all_at, J = at[~short], all_at[~short], J[~short]
                if not at.size:
                    break
                # two trial passes at its end, the second changes the slow variables by d_2
                near = y[at] + J[:, None] * first[at]
                trial = selected.take(at)
                trial.computed[:] = 0.0
                for _ in range(2):
                    _set_slow_variables(trial.state, near, self.material)
                    compute(trial, 1)
                run.computed[all_at] += trial.computed
                second = _slow_variables(trial.state, self.material) - near
                # accept or repeat the jump
                size = np.maximum(np.abs(first[at]), np.abs(second))[:, :2]  # of damage and strain
                half = 0.5 * np.abs(second - first[at])[:, :2]
                change = np.max(half / np.where(size > 0.0, size, 1.0), axis=1)
                ahead = y[at] + 0.5 * J[:, None] * (first[at] + second)
                broken = trial.broken | (ahead[:, 0] >= self.material.critical_damage)
                fits = ~broken & (change <= self.tolerance)
                ratio = 0.8 * self.tolerance / np.maximum(change, 1e-300)
                again = np.where(broken, 0.5, np.maximum(0.2, ratio))
                jump[all_at] = J * np.where(fits, np.minimum(LARGEST_GROWTH, ratio), again)
                _set_slow_variables(trial.state, ahead, self.material)
                accepted = all_at[fits]
                run.state[accepted] = trial.state[fits]
                run.cycles[accepted] += J[fits] * length[at[fits]]
                done[accepted] += J[fits]
                if accepted.size:
                    note(run)
                at = at[~fits]

    def lives(self, stress: np.ndarray, max_cycles: float) -> np.ndarray:
        """Return the cycles at which every inclusion cracks, infinite if later, (points,)."""
        start = np.zeros((stress.shape[1] * self.factors.size, STATE_SIZE))
        run = self.follow(start, stress, int(max_cycles))
        return np.where(run.broken, run.cycles, np.inf)

    def cracked(self, run: FatigueProgress) -> np.ndarray:
        """Share (1) of the inclusions of every element that have cracked."""
        return np.asarray(run.broken.reshape(-1, self.factors.size).mean(axis=1))


def _bends(stress: np.ndarray) -> np.ndarray:
    """Leave out corners of closed paths at which the paths of all elements are straight."""
    if np.array_equal(stress[0], stress[-1]) and len(stress) > 1:
        stress = stress[1:]
    corners, size = list(stress), float(np.abs(stress).max()) or 1.0
    k = 0
    while len(corners) > 2 and k < len(corners):
        before, here, after = corners[k - 1], corners[k], corners[(k + 1) % len(corners)]
        way = after - before
        long = np.sum(way**2, axis=-1)
        share = np.sum((here - before) * way, axis=-1) / np.where(long > 0.0, long, 1.0)
        off = here - before - np.clip(share, 0.0, 1.0)[:, None] * way
        if np.abs(off).max() <= STRAIGHT * size:
            del corners[k]
        else:
            k += 1
    return np.array(corners)


def two_scale_fatigue(
    stress: np.ndarray,
    material: FatigueMaterial,
    *,
    jump_tolerance: float | None = 0.02,
    max_cycles: float = 1e9,
    substeps: int = 16,
) -> Dataset:
    """Compute damage under a repeated cycle until a crack starts or the inclusion stays elastic.

    Parameters
    ----------
    stress : ndarray, shape (points,) or (points, 6)
        Corners of a closed path of the macro stress, joined by straight lines, Pa: uniaxial
        stress, or xx, yy, zz, yz, xz, xy. A program of several kinds of cycles is a single path.
    jump_tolerance : float, optional
        Bound on the relative difference between two extrapolations of the change over a jump of
        cycles: from its start, and from both its ends, which is used. None computes every cycle.
    substeps : int
        Steps for the plastic range of each straight segment. The flow is exact in any step; the
        errors of the feedback of damage and of the damage law are of second order in the steps.

    Returns
    -------
    Dataset
        Follows ``FATIGUE``: damage and plastic strain of the inclusion against cycles, and the
        numbers of cycles to initiation of damage and to rupture. The numbers are infinite if the
        inclusion stays or becomes elastic (``run_out`` 1), and NaN if ``max_cycles`` was reached
        before (``converged`` 0).

    Examples
    --------
    >>> steel = FatigueMaterial(200e9, 0.3, 200e6, 0.5e6, threshold=0.05, feedback=False)
    >>> life = two_scale_fatigue(np.array([210e6, -210e6]), steel)
    >>> round(float(life["cycles_to_rupture"]))
    4684
    """
    if jump_tolerance is not None:
        require("jump_tolerance", jump_tolerance, "(0, 1)")
    if not max_cycles >= 1.0 or substeps < 1:
        raise CaseError(
            f"max_cycles and substeps must be at least 1, got {max_cycles:g} and {substeps}"
        )
    try:
        path = np.asarray(stress, dtype=float)
    except (TypeError, ValueError) as error:
        raise CaseError(f"the stress of a cycle is a path of numbers, got {stress!r}") from error
    if path.ndim == 1:
        path = path[:, None] * np.eye(6)[0]
    if path.ndim != 2 or path.shape[1] != 6 or len(path) == 0:
        raise CaseError(
            f"the stress of a cycle needs the shape (points,) or (points, 6), got "
            f"{np.shape(stress)}"
        )
    if not np.all(np.isfinite(path)):
        raise CaseError("the stress of a cycle must be finite (Pa)")
    begin, record = perf_counter(), [(0.0, 0.0, 0.0)]

    def note(run: FatigueProgress) -> None:
        record.append((float(run.cycles[0]), float(run.state[0, 0]), float(run.state[0, 1])))

    inclusions = Inclusions(material, np.ones(1), jump_tolerance, substeps)
    start = np.zeros((1, STATE_SIZE))
    run = inclusions.follow(start, path[:, None], int(max_cycles), note)
    broken, elastic = bool(run.broken[0]), bool(run.elastic[0])
    ended = broken or elastic
    cycles, damage, strain = np.array(record).T
    initiation = np.inf if ended else np.nan
    if strain[-1] > material.threshold:
        after = int(np.argmax(strain > material.threshold))
        around = slice(after - 1, after + 1)
        initiation = float(np.interp(material.threshold, strain[around], cycles[around]))
    return FATIGUE.build(
        {
            "cycles": cycles,
            "damage": damage,
            "plastic_strain": strain,
            "cycles_to_initiation": initiation,
            "cycles_to_rupture": float(run.cycles[0]) if broken else np.inf if elastic else np.nan,
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
    amplitudes : ndarray, shape (steps,), half the range of stress, Pa
    stress_ratio : float, smallest over largest stress, below 1; -1 for reversed loading
    direction : ndarray, shape (6,), optional
        Stress per unit of amplitude, dimensionless; uniaxial if not given.
    jump_tolerance : float, optional, see :func:`two_scale_fatigue`

    Returns
    -------
    Dataset, follows ``WOEHLER``
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

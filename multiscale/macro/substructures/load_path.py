"""Paths of loads, step by step and then in closed cycles, and the answers at their steps."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from multiscale.errors import CaseError

FEW_STEPS = 2
"""Load steps from zero to an amplitude in the cycles at every preload."""

ROUNDING = 1e-9
"""Loss of a cycle, relative to the amplitude of its load times its displacement, that is zero."""


@dataclass(frozen=True)
class LoadPath:
    """Steps over named loads, then cycles of a load.

    Parameters
    ----------
    names : tuple of str, names of the load cases of an assembly, in the order of the assembly
    forces : tuple of float, resultant of each load at the factor 1, N
    steps : tuple of tuple of float, shape (steps, loads)
        Factors of all loads at the end of each step.
    substeps : int, equal load steps in every step
    cycled : str, load that is cycled about its last factor; none if empty
    amplitude : float, amplitude of its factor in the cycles
    cycles : int, closed cycles after the first rise
    cycle_steps : int, load steps of that rise: 4 of these make a cycle
    amplitudes : tuple of float
        Amplitudes of the shear of a joint, rising: a closed cycle of each at the end of every step,
        next to the path.
    amplitude_steps : int, load steps from zero to each of these amplitudes in its cycle

    Raises
    ------
    CaseError
        If a value is outside its range, or the cycled load is unknown.
    """

    names: tuple[str, ...]
    forces: tuple[float, ...]
    steps: tuple[tuple[float, ...], ...]
    substeps: int = 1
    cycled: str = ""
    amplitude: float = 1.0
    cycles: int = 0
    cycle_steps: int = 10
    amplitudes: tuple[float, ...] = ()
    amplitude_steps: int = FEW_STEPS

    kind: ClassVar[str] = "loads"  # of the answers, the attribute ``path`` of a result

    def __post_init__(self) -> None:
        if not self.steps or any(len(step) != len(self.names) for step in self.steps):
            raise CaseError(
                f"a path needs at least one step, with a factor for each of the loads "
                f"{', '.join(self.names)}, got {self.steps}"
            )
        if self.cycles and self.cycled not in self.names:
            raise CaseError(
                f"there is no load {self.cycled!r} to cycle; there are {', '.join(self.names)}"
            )
        if min(self.substeps, self.cycle_steps) < 1 or self.cycles < 0 or not self.amplitude > 0.0:
            raise CaseError(
                f"substeps and cycle_steps count from 1, cycles from 0, and the amplitude is "
                f"positive, got {self.substeps}, {self.cycle_steps}, {self.cycles} and "
                f"{self.amplitude:g}"
            )

    def factors(self) -> np.ndarray:
        """Factors of the loads at every load step, shape (load steps, loads)."""
        ends = np.array([np.zeros(len(self.names)), *self.steps])
        share = (np.arange(1, self.substeps + 1) / self.substeps)[:, None]
        path = [(1.0 - share) * last + share * end for last, end in pairwise(ends)]
        if self.cycles:
            rise = np.arange(1, self.cycle_steps + 1) / self.cycle_steps
            cycles = np.tile(closed_cycle(self.cycle_steps), self.cycles)
            swing = self.amplitude * np.append(rise, cycles)
            which = np.array(self.names) == self.cycled
            path.append(ends[-1] + np.outer(swing, which))
        return np.concatenate(path)

    def beside(self, step: int) -> np.ndarray:
        """Factors of the loads in the closed cycles of all amplitudes at the end of a step."""
        swing = np.outer(self.amplitudes, np.append(1.0, closed_cycle(self.amplitude_steps)))
        return self.steps[step] + np.outer(swing, np.array(self.names) == self.cycled)

    @property
    def count(self) -> int:
        """Number of load steps, including the cycles of all amplitudes."""
        beside = len(self.steps) * len(self.amplitudes) * (1 + 4 * self.amplitude_steps)
        return len(self.ends()) + beside

    @property
    def few(self) -> int:
        """Steps to the amplitude of a cycle that is followed again; 0 without cycles."""
        return max(1, min(FEW_STEPS, self.cycle_steps // 2)) if self.cycles else 0

    def shortened(self, solved: int, closes: bool) -> "LoadPath":
        """Return the steps that are solved and, if the path ``closes``, cycles of few steps.

        Cycles of all amplitudes, of a step to each, replace the cycles at the end.
        """
        return replace(
            self,
            steps=self.steps[:solved],
            cycles=int(closes and self.cycles > 0 and not self.amplitudes),
            cycle_steps=self.few or 1,
            amplitudes=self.amplitudes if closes else (),
            amplitude_steps=1,
        )

    def closed(self) -> list[slice]:
        """Return the load steps of every cycle, with both ends."""
        rise, cycle = self.substeps * len(self.steps) + self.cycle_steps, 4 * self.cycle_steps
        starts = rise - 1 + cycle * np.arange(self.cycles)
        return [slice(start, start + cycle + 1) for start in starts.tolist()]

    def cycle_energy(self, displacement: np.ndarray) -> np.ndarray:
        """Energy dissipated in every cycle, J, from the displacement of all loads, (steps, loads).

        See :func:`cycle_work`.
        """
        case = self.names.index(self.cycled)
        q = np.array([displacement[cycle, case] for cycle in self.closed()])
        return np.asarray(self.forces[case] * cycle_work(self.amplitude, q))

    def ends(self) -> np.ndarray:
        """Step that each load step ends, or -1, shape (load steps,)."""
        number = np.full(len(self.factors()), -1)
        last = self.substeps * (1 + np.arange(len(self.steps))) - 1
        number[last] = np.arange(len(self.steps))
        return number

    def labels(self) -> dict[str, list[str]]:
        """Return the labels of the loads in a result."""
        return {"load": list(self.names)}

    def rise(self, step: int) -> np.ndarray | None:
        """Signs of a small rise of every load away from zero at a load step, for its tangents."""
        return np.where(self.factors()[step] < 0.0, -1.0, 1.0)

    def describe(self) -> list[str]:
        """Describe the loads with a factor other than zero, at every load step."""
        return [
            f"the loads {', '.join(f'{name} {factor:.4g}' for name, factor in acting) or 'zero'}"
            for acting in (
                [load for load in zip(self.names, row, strict=True) if load[1]]
                for row in self.factors()
            )
        ]

    def answers(self, moved: np.ndarray, work: np.ndarray, jointed: bool) -> dict[str, Any]:
        """Return factors, displacements and stiffnesses of the loads.

        They follow from displacements, shape (steps, loads), m, and
        :attr:`~.measures.FollowedLoads.work`, with or without interfaces.
        """
        factors, forces = self.factors(), np.array(self.forces)
        (stuck, *_), (whole, of_interfaces, _) = work
        free = np.isinf(whole)
        return {
            "factor": factors,
            "load_displacement": moved,
            "load_secant": _secants(factors, moved, forces, not jointed),
            "load_stiffness": forces**2 / whole,
            "stuck_stiffness": forces**2 / stuck,
            "interface_compliance": np.where(free, 1.0, of_interfaces / np.where(free, 1.0, whole)),
        }


class JointPath(LoadPath):
    """Preload and shear of a joint, 1 Pa on faces with the forces as areas, m²."""

    kind = "joint"

    def labels(self) -> dict[str, list[str]]:
        """Return no labels: the answers name preload and shear."""
        return {}

    def rise(self, step: int) -> None:
        """Return no rise: the stiffnesses of joints are without slip."""

    def describe(self) -> list[str]:
        """Return no descriptions: a step is described by its preload."""
        return []

    def answers(self, moved: np.ndarray, work: np.ndarray, jointed: bool) -> dict[str, Any]:
        """Return loads, displacements and stiffnesses per area of the pressed and sheared faces."""
        (preload, shear), (approach, along) = self.factors().T, moved.T
        pressed, sheared = self.forces
        whole, of_joints, of_bodies = work[0]
        return {
            "preload": preload,
            "shear": shear,
            "approach": approach,
            "shear_displacement": along,
            "joint_stiffness": pressed / whole[:, 0],
            "tangential_stiffness": sheared / whole[:, 1],
            "interface_stiffness": pressed / of_joints[:, 0],
            "solid_stiffness": pressed / of_bodies[:, 0],
        }


def joint_path(
    preloads: Sequence[float],
    shear: float = 0.0,
    cycles: int = 0,
    steps: int = 10,
    amplitudes: Sequence[float] = (),
) -> LoadPath:
    """Return a path over preloads in turn, then cycles of shear at the last, or at all of them.

    Parameters
    ----------
    preloads : sequence of float, pressures on the pressed face, Pa
    shear : float, amplitude of the tangential traction on the sheared face, Pa
    cycles : int, closed cycles from the positive to the negative amplitude and back
    steps : int, load steps from zero to the amplitude: 4 of these make a cycle
    amplitudes : sequence of float
        Amplitudes of the shear, Pa, rising: a cycle of each at every preload, next to the path.

    Raises
    ------
    CaseError
        If a value is outside its range.
    """
    if not preloads or not all(0.0 < p < np.inf for p in preloads):
        raise CaseError(f"preloads must be positive (Pa), got {list(preloads)}")
    if cycles < 0 or steps < 1 or (cycles and not 0.0 < shear < np.inf):
        raise CaseError(
            f"cycles need a positive shear (Pa) and at least one step, got {cycles} cycles, "
            f"{shear:g} Pa and {steps} steps"
        )
    if not np.all(np.diff(amplitudes, prepend=0.0) > 0.0):
        raise CaseError(f"amplitudes must be positive and rise (Pa), got {list(amplitudes)}")
    return JointPath(
        ("preload", "shear"),
        (1.0, 1.0),
        tuple((preload, 0.0) for preload in preloads),
        cycled="shear",
        amplitude=shear or 1.0,
        cycles=cycles,
        cycle_steps=steps,
        amplitudes=tuple(amplitudes),
    )


def closed_cycle(steps: int) -> np.ndarray:
    """Shear over its amplitude from the positive to the negative amplitude and back."""
    rise = np.arange(1, steps + 1) / steps
    return np.concatenate([1.0 - rise, -rise, rise - 1.0, rise])


def cycle_work(amplitude: np.ndarray | float, displacement: np.ndarray) -> np.ndarray:
    r"""Work of a closed cycle of shear."""
    half = displacement.shape[-1] // 2
    weight = np.ones(half + 1)
    weight[1:-1:2], weight[2:-1:2] = 4.0, 2.0
    # Simpson's rule over the loop
    back, forth = displacement[..., : half + 1], displacement[..., half:]
    enclosed = 2.0 / (3.0 * half) * np.asarray(amplitude) * ((back - forth) @ weight)
    work = np.asarray(amplitude * (displacement[..., -1] - displacement[..., 0]) + enclosed)
    rounding = ROUNDING * np.abs(amplitude) * np.ptp(displacement, axis=-1)
    return np.where(np.abs(work) < rounding, 0.0, work)


def _secants(
    factors: np.ndarray, displacement: np.ndarray, forces: np.ndarray, at_rest: bool
) -> np.ndarray:
    """Stiffness of every load since it was zero, N/m; NaN if another load has changed since."""
    first = np.zeros((int(at_rest), len(forces)))
    factor, moved = np.vstack([first, factors]), np.vstack([first, displacement])
    secant = np.full(factor.shape, np.nan)
    for case, force in enumerate(forces):
        others = np.delete(factor, case, axis=1)
        for step in range(1, len(factor)):
            zero = np.flatnonzero(factor[:step, case] == 0.0)
            if not zero.size or factor[step, case] == 0.0:
                continue
            begin = zero[-1]
            if np.all(others[begin : step + 1] == others[begin]):
                change = force * factor[step, case]
                secant[step, case] = change / (moved[step, case] - moved[begin, case])
    return secant[len(first) :]

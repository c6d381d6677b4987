"""From a target for the error of an answer to the setting of least time that reaches it.

The next setting is the cheapest of all steps of few rungs with an expected error below the target;
the distance of its answer from the prediction is a bias, too.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import inf, isfinite, nan

import numpy as np

from multiscale.errors import CaseError, ConvergenceError, MultiscaleError
from multiscale.pipeline.plans.knob_errors import (
    MINOR,
    SAMPLING,
    KnobError,
    Outcome,
    PlanState,
    SourceCost,
    at_places,
    further_cells,
    measure_error,
    measure_growth,
)
from multiscale.pipeline.plans.knobs import HIGHEST, CaseKnob, Setting

MOST_ROUNDS = 10
AIM = 0.85
"""Expected error over the target, for a plan."""

STEPS, ADDED, FEWER = 2, 4, 2
"""Rungs of a knob in a round, of a knob that adds cells, and down of it, where cells are larger."""

MOST_GROWTH = 10.0
"""Time of a round over the time of the last answer: early errors show little of later errors."""

Solve = Callable[[Setting, bool], Outcome]
"""Maps a setting to its answer, with or without its budget."""


@dataclass(frozen=True)
class Round:
    """A setting that was solved: its error, relative, its seconds, and their expected values."""

    setting: Setting
    error: float
    seconds: float
    expected_error: float = nan
    expected_seconds: float = nan  # of the setting with its coarsened settings


@dataclass(frozen=True, eq=False)
class Reached:
    """The answer of a plan."""

    state: PlanState
    error: np.ndarray  # shape (places,), relative 95 % bound on the error of the value
    rounds: Sequence[Round]
    sources: Sequence[SourceCost]  # the largest error first
    halving: Round | None  # the cheapest setting that is expected to halve the error
    stopped: str = ""  # why the target was not reached


@dataclass(eq=False)
class Planner:
    """Rounds of settings towards a target."""

    knobs: Sequence[CaseKnob]
    solve: Solve
    lowest: Mapping[str, int]  # rung of every knob
    target: float = inf  # largest relative error; inf if only the time counts
    time: float = inf  # limit for the seconds of all solves
    spent: Callable[[], float] = lambda: 0.0  # seconds so far
    report: Callable[[str], None] = lambda line: None  # takes a sentence after every round
    expect: Callable[[float, float], None] = lambda spent, total: None
    """Called before every round with the seconds so far and the expected seconds to the target."""
    refused: list[tuple[Setting, str]] = field(default_factory=list)
    """Settings without an answer, as all settings above them, with their sentences."""

    def run(self) -> Reached:
        """Solve settings until the error is below the target, or the time is over."""
        rounds = list[Round]()
        # a knob that is measured has a rung below the first
        start = {knob.name: self.lowest[knob.name] + knob.measured for knob in self.knobs}
        step = Round(start, nan, nan)
        state: PlanState | None = None
        while True:
            before, begin = state, self.spent()
            state, step = self._advance(state, step)
            error = float(np.max(state.error()))
            if state is not before:
                seconds = self.spent() - begin
                rounds.append(replace(step, error=error, seconds=seconds))
                self.report(_line(len(rounds), rounds[-1]))
            if error <= self.target < inf:
                break
            growth = MOST_GROWTH * sum(state.outcome.seconds.values())
            left = self.time - self.spent()
            chosen = self.choose(state, min(left, growth)) or self.choose(state, left)
            if chosen is None or len(rounds) == MOST_ROUNDS or self._floor(state):
                break
            step = chosen
            aimed = self.cheapest(state, AIM * self.target, inf) or step
            self.expect(self.spent(), min(self.spent() + aimed.expected_seconds, self.time))
        return Reached(
            state,
            state.error(),
            rounds,
            sorted(state.sources(), key=lambda source: -source.error),
            self.cheapest(state, 0.5 * error, inf),
            "" if error <= self.target else self._reason(state, error, len(rounds)),
        )

    def _advance(self, state: PlanState | None, step: Round) -> tuple[PlanState, Round]:
        """Solve a setting, or first settings that are finer until they have an answer.

        No setting at or above a setting without an answer is tried again, unless smaller steps may
        lead to it.
        """
        try:
            return self.measure(step.setting, state), step
        except MultiscaleError as error:
            finer = {name: max(rung, min(rung + 1, 0)) for name, rung in step.setting.items()}
            if state is None and (finer == step.setting or not isinstance(error, ConvergenceError)):
                raise
            refusal = f"the setting {_rungs(step.setting)} has no answer: {error}"
            self.report(refusal)
        if state is None:
            return self._advance(None, Round(finer, nan, nan))
        self.refused.append((step.setting, refusal))
        return state, step

    def _is_refused(self, setting: Setting) -> bool:
        """Whether a setting is at or above a setting without an answer, and its steps are too."""
        easing = {knob.name for knob in self.knobs if knob.eases}
        return any(
            all(setting[k] <= low[k] if k in easing else setting[k] >= low[k] for k in low)
            for low, _ in self.refused
        )

    def measure(self, setting: Setting, before: PlanState | None) -> PlanState:
        """Solve the answer at a setting, and below it for every knob that matters."""
        outcome = self.solve(setting, True)
        state = PlanState(self.knobs, setting, outcome)
        if before is None and (floor := self._floor(state)):  # without the coarser settings
            raise CaseError(floor)
        left, growth = dict[str, KnobError](), dict(before.growth) if before else {}
        for knob in (knob for knob in self.knobs if knob.measured):
            name, old = knob.name, before.left.get(knob.name) if before else None
            settled = before is not None and before.is_settled(knob, self.target)
            if old is not None and settled and old.rung == setting[name]:
                left[name] = old.on(outcome.value)
                continue
            left[name], powers = self._coarsen(knob, state, old)
            growth |= powers
        state = replace(state, left=left, growth=growth)
        if before is None:
            return state
        first = before.first or before
        state = replace(state, first=first, falls=state.falls_from(first))
        moved = (knob for knob in self.knobs if setting[knob.name] != before.setting[knob.name])
        if any(knob.adds or knob.scatters for knob in moved):
            return state  # other cells
        bias = sum(np.max(old.bias) for old in before.left.values())
        away = np.max(np.abs(at_places(state.value, before.value) / before.value - 1.0))
        return replace(state, prediction_error=max(float(away - bias), 0.0))

    def _coarsen(
        self, knob: CaseKnob, state: PlanState, old: KnobError | None
    ) -> tuple[KnobError, Mapping[tuple[str, str], float]]:
        """Solve the answer at the rung below a knob: the error of the knob, and growth of times."""
        name, setting, outcome = knob.name, state.setting, state.outcome
        further = further_cells(self.knobs, knob, setting)
        below = {**setting, name: setting[name] - 1}
        ratio = outcome.ratio.get(name, 2.0)
        if ratio <= 1.0:
            raise CaseError(
                f"the {name} at the setting {_rungs(setting)} and at the coarser setting "
                f"{_rungs(below)} are the same, and their error is not known; give other "
                f"{name}, or leave the target out"
            )
        more = {cells.name: setting[cells.name] + rungs for cells, rungs in further.items()}
        try:
            coarse = self.solve(below | more, False)
        except CaseError:
            if not any(further.values()):
                raise
            further = {}  # as many cells, if there is no room for more
            coarse = self.solve(below, False)
        if coarse.value.shape != outcome.value.shape or not np.isfinite(coarse.value).all():
            raise CaseError(
                f"the answer at the coarser setting {_rungs(below)} is not known at all of its "
                f"places, so its error by {name} is unknown; choose another answer, or give "
                f"finer settings"
            )
        difference = 1.0 - coarse.value / outcome.value
        sampling = outcome.half_width.get(SAMPLING, np.zeros(outcome.value.shape))
        fall = knob.draws - sum(rungs * cells.orders[0] for cells, rungs in further.items())
        chance = sampling * np.hypot(1.0, 2.0**fall)
        return (
            measure_error(knob, difference, setting[name], old, chance, ratio),
            measure_growth(knob, further, outcome.seconds, coarse.seconds),
        )

    def choose(self, state: PlanState, time: float) -> Round | None:
        """Return the next setting, None if no step fits into the time or helps."""
        now = float(np.max(state.error()))
        aim = AIM * self.target
        for goal in (aim, np.sqrt(aim * now)) if isfinite(aim) else ():
            step = self.cheapest(state, goal, time)
            if step is not None:
                return step
        helping = [
            step
            for step in self.steps(state)
            if step.expected_error < 0.95 * now and step.expected_seconds <= time
        ]
        return min(helping, key=lambda s: (s.expected_error, s.expected_seconds), default=None)

    def cheapest(self, state: PlanState, goal: float, time: float) -> Round | None:
        """Return the cheapest step with an expected error below a goal."""
        fit = [
            step
            for step in self.steps(state)
            if step.expected_error <= goal and step.expected_seconds <= time
        ]
        return min(fit, key=lambda step: step.expected_seconds, default=None)

    def steps(self, state: PlanState) -> Iterator[Round]:
        """Yield the settings of the next round, with their expected errors and seconds."""
        ranges = []
        larger = [knob.name for knob in self.knobs if knob.scatters]
        for knob in self.knobs:
            fewest = self.lowest[knob.name] - state.setting[knob.name]
            fewer = min(max(-fewest, 0), FEWER) if knob.adds and larger else 0
            most = 1 if knob.scatters else ADDED if knob.adds else STEPS
            room = HIGHEST - state.setting[knob.name]
            useful = knob.adds or knob.draws or knob.scatters or state.matters(knob)
            ranges.append(range(-fewer, 1 + (min(most, max(room, 0)) if useful else 0)))
        for rungs in product(*ranges):
            if not any(rungs):
                continue
            up = {knob.name: u for knob, u in zip(self.knobs, rungs, strict=True)}
            if min(rungs) < 0 and not any(up[name] for name in larger):
                continue
            setting = {name: rung + up[name] for name, rung in state.setting.items()}
            if self._is_refused(setting):
                continue
            error = float(np.max(state.error(up)))
            yield Round(setting, nan, nan, error, state.seconds(up, self.target))

    def _floor(self, state: PlanState) -> str:
        """Report terms that no knob reduces if the target is below them."""
        if not (every := state.fixed(0.0)):
            return ""
        floor = float(np.max(np.linalg.norm([state.half_width[term] for term in every], axis=0)))
        if floor <= self.target:
            return ""
        fixed = {term: error for term, error in every.items() if error > MINOR * floor}
        named = " and ".join(f"{term} ({100.0 * error:.2g} %)" for term, error in fixed.items())
        return (
            f"an error of {100.0 * self.target:.3g} % is out of reach: no setting of the case "
            f"reduces {named}; set a target above {100.0 * floor:.2g} %, or change what that "
            f"comes from"
        )

    def _reason(self, state: PlanState, error: float, rounds: int) -> str:
        if floor := self._floor(state):
            return floor
        aimed = self.cheapest(state, AIM * self.target, inf)
        more = f"; a setting for it takes about {aimed.expected_seconds:.3g} s" if aimed else ""
        why = "no step that reduces it fits into the time"
        if rounds == MOST_ROUNDS:
            why = f"{MOST_ROUNDS} rounds are over"
        elif self.choose(state, inf) is None:
            largest = max(state.sources(), key=lambda source: source.error)
            why = (
                f"no further setting of the case reduces it; its largest part is {largest.name} "
                f"({100.0 * largest.error:.2g} %)"
            )
            why += f"; {self.refused[-1][1]}" if self.refused else ""
        return (
            f"the error is {100.0 * error:.3g} %, above the target of {100.0 * self.target:.3g} %, "
            f"and {why}{more}"
        )


def _rungs(setting: Setting) -> str:
    moved = ", ".join(f"{name} {rung:+d}" for name, rung in setting.items() if rung)
    return moved or "the given case"


def _line(number: int, done: Round) -> str:
    expected = ""
    if isfinite(done.expected_error):
        expected = (
            f", {100.0 * done.expected_error:.3g} % and {done.expected_seconds:.3g} s expected"
        )
    return (
        f"round {number}: {_rungs(done.setting)}; error {100.0 * done.error:.3g} % "
        f"after {done.seconds:.3g} s{expected}"
    )

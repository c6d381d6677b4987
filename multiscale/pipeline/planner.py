r"""From a target for the error of an answer to the setting of least time that reaches it.

An answer :math:`A(v)` has a setting :math:`v` of knobs on ladders. Its budget has the errors of
sampling and of the fit, which knobs lower in proportion, and biases, which are taken out of the
answer: their half-widths are left. Every other knob is coarsened by a rung *at the answer*, and the
difference shows the error that it leaves, as no cross term is missing there:

.. math:: \Delta_k = A(v) - A(v - e_k), \qquad
    \epsilon_k = \frac{\Delta_k}{r_k^{p_k} - 1}.    \tag{1}

The ratio :math:`r_k` of the spacings is 2, or less where a mesh hardly differs. The order
:math:`p_k` is taken where two differences show it, or where its range is narrow; then
:math:`\epsilon_k` is added to the answer, and half of its range is a bias. Otherwise
:math:`|\Delta_k| / (r_k^{p_{\min}} - 1)` is. Between cells with other surfaces no order is seen:
:math:`\epsilon_k` lies between zero and its value for the lowest order, and the middle is added.
The half-width of the difference by chance counts with it, however small it is; smaller cells are
more, by their larger scatter. The seconds of a stage grow with every knob by a power of two,
measured by the same differences. The next setting is the cheapest of all steps of few rungs with
an expected error below the target; the distance of its answer from the prediction is a bias, too.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import inf, isfinite, log2, nan

import numpy as np

from multiscale.errors import CaseError, ConvergenceError, MultiscaleError
from multiscale.pipeline.knobs import HIGHEST, Knob, Setting
from multiscale.upscaling.budget import total_error

MOST_ROUNDS = 10
AIM = 0.85
"""Expected error over the target, for a plan."""

STEPS, ADDED, FEWER = 2, 4, 2
"""Rungs of a knob in a round, of a knob that adds cells, and down of it, where cells are larger."""

MOST_GROWTH = 10.0
"""Time of a round over the time of the last answer: early errors show little of later errors."""

NARROW = 0.5  # width of a range of orders that is taken without two differences
BELOW, ABOVE = 0.5, 0.7  # distance of an observed order from its range, at most
NEAR = 0.5  # distance of an order from the observed order, at most
CLEAR_RATIO = 1.8  # of spacings, below which two differences show no order
NEGLIGIBLE = 0.05
"""Error of a knob over the target below which it is not measured again at the next setting, and of
a term over a whole error below which it is not named."""

LEAST_FALL = 0.1  # power of two below which a knob does not lower a term

SAMPLING = "sampling"


@dataclass(frozen=True, eq=False)
class Outcome:
    """An answer at a setting."""

    value: np.ndarray  # shape (places,), any unit
    half_width: Mapping[str, np.ndarray]  # by terms, relative; empty without a budget
    seconds: Mapping[str, float]  # of the stages, s
    bias: Mapping[str, np.ndarray] = field(default_factory=dict)  # with signs, by terms likewise
    ratio: Mapping[str, float] = field(default_factory=dict)  # r in (1) by knobs, if it is not 2


Solve = Callable[[Setting, bool], Outcome]
"""Maps a setting to its answer, with or without its budget."""


@dataclass(frozen=True, eq=False)
class KnobError:
    """Error that a knob leaves in an answer, relative, shape (places,)."""

    correction: np.ndarray  # to be added to the answer
    bias: np.ndarray  # largest error after it
    noise: np.ndarray  # its 95 % half-width by chance, in which an effect may stay hidden
    order: float  # observed, NaN if none is
    difference: np.ndarray  # (1), from which it follows
    rung: int  # at which it was measured

    @property
    def size(self) -> float:
        """Largest error over the places."""
        return float(np.max(self.bias + self.noise))

    def on(self, values: np.ndarray) -> "KnobError":
        """Return the error at the places of values, which may be more."""
        return replace(
            self,
            correction=_on(self.correction, values),
            bias=_on(self.bias, values),
            noise=_on(self.noise, values),
            difference=_on(self.difference, values),
        )


@dataclass(frozen=True, eq=False)
class State:
    """An answer at a setting, with the errors that its knobs leave."""

    setting: Setting
    outcome: Outcome
    left: Mapping[str, KnobError]
    growth: Mapping[tuple[str, str], float]  # power of two by stage and knob
    replaced: Collection[str]  # terms of the budget that measured knobs replace
    falls: Mapping[str, float]  # powers of two by which terms in ``lowers`` of knobs fell
    prediction_error: float = 0.0  # distance from the prediction, relative

    @property
    def value(self) -> np.ndarray:
        """The corrected answer."""
        biases = self.outcome.bias.items()  # NaN where none is known
        known = sum(np.nan_to_num(bias) for term, bias in biases if term not in self.replaced)
        corrections = sum(left.correction for left in self.left.values())
        return np.asarray(self.outcome.value * (1.0 - known) * (1.0 + corrections))

    @property
    def half_width(self) -> dict[str, np.ndarray]:
        """Half-widths by the terms of the budget that no measured knob replaces."""
        widths = self.outcome.half_width.items()
        return {term: np.nan_to_num(half) for term, half in widths if term not in self.replaced}


@dataclass(frozen=True)
class Round:
    """A setting that was solved: its error, relative, its seconds, and their expected values."""

    setting: Setting
    error: float
    seconds: float
    expected_error: float = nan
    expected_seconds: float = nan  # of the setting with its coarsened settings


@dataclass(frozen=True)
class SourceCost:
    """Error that a source leaves, and the seconds that halve it."""

    name: str
    error: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Reached:
    """The answer of a plan."""

    state: State
    error: np.ndarray  # shape (places,), relative 95 % bound on the error of the value
    rounds: Sequence[Round]
    sources: Sequence[SourceCost]  # the largest error first
    halving: Round | None  # the cheapest setting that is expected to halve the error
    stopped: str = ""  # why the target was not reached


@dataclass(eq=False)
class Planner:
    """Rounds of settings towards a target."""

    knobs: Sequence[Knob]
    solve: Solve
    lowest: Mapping[str, int]  # rung of every knob
    target: float = inf  # largest relative error; inf if only the time counts
    time: float = inf  # limit for the seconds of all solves
    spent: Callable[[], float] = lambda: 0.0  # seconds so far
    report: Callable[[str], None] = lambda line: None  # takes a sentence after every round
    expect: Callable[[float, float], None] = lambda spent, total: None
    """Takes the seconds so far, and those until the target, as expected, before every round."""
    refused: list[Setting] = field(default_factory=list)  # with all settings above them

    def run(self) -> Reached:
        """Solve settings until the error is below the target, or the time is over."""
        rounds = list[Round]()
        # a knob that is measured has a rung below the first
        start = {knob.name: self.lowest[knob.name] + knob.measured for knob in self.knobs}
        step = Round(start, nan, nan)
        state: State | None = None
        while True:
            before, begin = state, self.spent()
            state, step = self._advance(state, step)
            error = float(np.max(self.error(state)))
            if state is not before:
                seconds = self.spent() - begin
                rounds.append(replace(step, error=error, seconds=seconds))
                self.report(_line(len(rounds), rounds[-1]))
            if error <= self.target < inf:
                break
            self._refuse_floor(state)
            growth = MOST_GROWTH * sum(state.outcome.seconds.values())
            left = self.time - self.spent()
            chosen = self.choose(state, min(left, growth)) or self.choose(state, left)
            if chosen is None or len(rounds) == MOST_ROUNDS:
                break
            step = chosen
            aimed = self.cheapest(state, AIM * self.target, inf) or step
            self.expect(self.spent(), min(self.spent() + aimed.expected_seconds, self.time))
        return Reached(
            state,
            self.error(state),
            rounds,
            sorted(self.sources(state), key=lambda source: -source.error),
            self.cheapest(state, 0.5 * error, inf),
            "" if error <= self.target else self._reason(state, error, len(rounds)),
        )

    def _advance(self, state: State | None, step: Round) -> tuple[State, Round]:
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
            self.report(f"the setting {_rungs(step.setting)} has no answer: {error}")
        if state is None:
            return self._advance(None, Round(finer, nan, nan))
        self.refused.append(step.setting)
        return state, step

    def _is_refused(self, setting: Setting) -> bool:
        """Whether a setting is at or above a setting without an answer, and its steps are too."""
        easing = {knob.name for knob in self.knobs if knob.eases}
        return any(
            all(setting[k] <= low[k] if k in easing else setting[k] >= low[k] for k in low)
            for low in self.refused
        )

    def measure(self, setting: Setting, before: State | None) -> State:
        """Solve the answer at a setting, and below it for every knob that matters."""
        outcome = self.solve(setting, True)
        replaced = {term for knob in self.knobs if knob.measured for term in knob.terms}
        if before is None:  # without the coarser settings
            self._refuse_floor(State(setting, outcome, {}, {}, replaced, {}))
        left, growth = dict[str, KnobError](), dict(before.growth) if before else {}
        sampling = outcome.half_width.get(SAMPLING, np.zeros(outcome.value.shape))
        bound = self.target if isfinite(self.target) else 0.0
        for knob in self.knobs:
            if not knob.measured:
                continue
            name, old = knob.name, before.left.get(knob.name) if before else None
            fixed = before is not None and setting[name] == before.setting[name]
            if old is not None and fixed and old.size < NEGLIGIBLE * bound:
                left[name] = old.on(outcome.value)
                continue
            more = self._more(knob)
            below = {**setting, name: setting[name] - 1}
            below |= {cells.name: setting[cells.name] + rungs for cells, rungs in more.items()}
            ratio = outcome.ratio.get(name, 2.0)
            if ratio <= 1.0:
                raise CaseError(
                    f"the {name} at the setting {_rungs(setting)} and at the coarser setting "
                    f"{_rungs(below)} are the same, and their error is not known; ask for other "
                    f"{name}, or leave the target out"
                )
            coarse = self.solve(below, False)
            if coarse.value.shape != outcome.value.shape or not np.isfinite(coarse.value).all():
                raise CaseError(
                    f"the answer at the coarser setting {_rungs(below)} is not known at all of its "
                    f"places, and its error by {name} neither; ask for another answer, or give "
                    f"finer settings"
                )
            difference = 1.0 - coarse.value / outcome.value
            chance = sampling * np.hypot(1.0, 1.0 if more else 2.0**knob.draws)
            left[name] = _left(knob, difference, setting[name], old, chance, ratio)
            growth |= self._growth(knob, outcome.seconds, coarse.seconds)
        falls = {} if before is None else self._falls(setting, outcome, before)
        state = State(setting, outcome, left, growth, replaced, falls)
        if before is None or any(
            setting[knob.name] != before.setting[knob.name] and (knob.adds or knob.scatters)
            for knob in self.knobs
        ):
            return state  # other cells
        bias = sum(np.max(old.bias) for old in before.left.values())
        away = np.max(np.abs(_on(state.value, before.value) / before.value - 1.0))
        return replace(state, prediction_error=max(float(away - bias), 0.0))

    def _more(self, knob: Knob) -> dict[Knob, int]:
        """Return the rungs by which cells of the rung below a knob are more: they scatter more.

        So many have the scatter of the rung, and take less time.
        """
        adding = [cells for cells in self.knobs if cells.adds and knob.scatters]
        return {cells: round(knob.draws / cells.orders[0]) for cells in adding}

    def _time_of_more(self, knob: Knob, stage: str) -> float:
        """Return the power of two by which these cells take more time."""
        return sum(rungs * cells.costs.get(stage, 0.0) for cells, rungs in self._more(knob).items())

    def _growth(
        self, knob: Knob, fine: Mapping[str, float], coarse: Mapping[str, float]
    ) -> dict[tuple[str, str], float]:
        """Return the powers of two by which the seconds of stages grow with a knob."""
        powers = {}
        for stage, seconds in fine.items():
            less = coarse.get(stage, 0.0) * 2.0 ** -self._time_of_more(knob, stage)
            if seconds > 0.0 and less > 0.0:
                powers[stage, knob.name] = float(np.clip(log2(seconds / less), 0.0, 4.0))
        return powers

    def _falls(self, setting: Setting, outcome: Outcome, before: State) -> dict[str, float]:
        """Return the powers of two by which terms that knobs should lower fell, rung by rung."""
        falls = dict(before.falls)
        for knob in self.knobs:
            rungs = setting[knob.name] - before.setting[knob.name]
            for term in knob.lowers if rungs > 0 else ():
                new, old = (
                    float(np.max(done.half_width.get(term, 0.0)))
                    for done in (outcome, before.outcome)
                )
                if old > 0.0 and new > 0.0:
                    falls[term] = max(log2(old / new) / rungs, 0.0)
        return falls

    def error(self, state: State, up: Setting | None = None) -> np.ndarray:
        """Return the error of the answer, or the error expected so many rungs higher."""
        up, rung = up or {}, {knob.name: knob for knob in self.knobs}
        square = np.zeros(state.outcome.value.shape)
        for term, half in state.half_width.items():
            square = square + (2.0 ** -self._fall(state, up, term) * half) ** 2
        bias, chance = (
            np.full(square.shape, state.prediction_error),
            self._fall(state, up, SAMPLING),
        )
        for name, left in state.left.items():
            fall = _expected_order(rung[name], left) * up.get(name, 0)
            # a difference within its chance is expected to fall as the chance does
            falls = np.where(left.bias <= 0.5 * left.noise, np.maximum(fall, chance), fall)
            bias = bias + 2.0**-falls * left.bias + 2.0**-chance * left.noise
        return total_error(bias, np.sqrt(square))

    def _fall(self, state: State, up: Setting, term: str) -> float:
        """Return the power of two by which a term is expected to fall so many rungs higher."""
        fall = 0.0
        for knob in self.knobs:
            power = knob.draws if term == SAMPLING else 0.0
            if term in (*knob.terms, *knob.lowers):
                power += state.falls.get(term, knob.orders[0])
            fall += power * up.get(knob.name, 0)
        return fall

    def choose(self, state: State, time: float) -> Round | None:
        """Return the next setting, None if no step fits into the time or helps."""
        now = float(np.max(self.error(state)))
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

    def cheapest(self, state: State, goal: float, time: float) -> Round | None:
        """Return the cheapest step with an expected error below a goal."""
        fit = [
            step
            for step in self.steps(state)
            if step.expected_error <= goal and step.expected_seconds <= time
        ]
        return min(fit, key=lambda step: step.expected_seconds, default=None)

    def steps(self, state: State) -> Iterator[Round]:
        """Yield the settings of the next round, with their expected errors and seconds."""
        ranges = []
        larger = [knob.name for knob in self.knobs if knob.scatters]
        for knob in self.knobs:
            fewest = self.lowest[knob.name] - state.setting[knob.name]
            fewer = min(max(-fewest, 0), FEWER) if knob.adds and larger else 0
            most = 1 if knob.scatters else ADDED if knob.adds else STEPS
            room = HIGHEST - state.setting[knob.name]
            useful = knob.adds or knob.draws or knob.scatters or self._matters(state, knob)
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
            error = float(np.max(self.error(state, up)))
            yield Round(setting, nan, nan, error, self.seconds(state, up))

    def _matters(self, state: State, knob: Knob) -> bool:
        """Whether a knob has an error worth lowering."""
        if knob.name in state.left:
            return bool(np.max(state.left[knob.name].bias) > 0.0)
        lowered = (*knob.terms, *knob.lowers)
        return any(np.any(state.half_width.get(term, 0.0)) for term in lowered)

    def seconds(self, state: State, up: Setting) -> float:
        """Forecast the seconds of the next round: the answer, and its coarsened settings."""
        total = 0.0
        for stage, now in state.outcome.seconds.items():
            power = {knob.name: self._power(state, stage, knob) for knob in self.knobs}
            there = now * 2.0 ** sum(power[name] * u for name, u in up.items())
            raised = [k for k in self.knobs if up[k.name] and power[k.name]]
            stored = any(knob.adds and stage in knob.costs for knob in self.knobs)
            further = stored and all(knob.adds for knob in raised)
            new = there - now if further else there  # further cells only, or all
            total += new
            for knob in self.knobs:
                small = knob.name in state.left and not up[knob.name]
                if not knob.measured or (
                    small and state.left[knob.name].size < NEGLIGIBLE * min(self.target, 1.0)
                ):
                    continue
                if power[knob.name] or not stored:
                    total += new * 2.0 ** (self._time_of_more(knob, stage) - power[knob.name])
        return total

    def _power(self, state: State, stage: str, knob: Knob) -> float:
        return state.growth.get((stage, knob.name), knob.costs.get(stage, 0.0))

    def sources(self, state: State) -> Iterator[SourceCost]:
        """Yield every source of error with the seconds that halve it."""

        def halving(knob: Knob | None, order: float) -> float:
            if knob is None:
                return nan
            seconds = state.outcome.seconds
            powers = {stage: self._power(state, stage, knob) for stage in seconds}
            return halving_seconds(seconds, powers, order, knob.adds)

        for term, half in state.half_width.items():
            knob = next((k for k in self.knobs if term in (*k.terms, *k.lowers)), None)
            seconds = halving(knob, knob.orders[0] if knob else nan)
            yield SourceCost(term, float(np.max(half)), seconds)
        for knob in self.knobs:
            if knob.name in state.left:
                left = state.left[knob.name]
                yield SourceCost(knob.name, left.size, halving(knob, _expected_order(knob, left)))
        if state.prediction_error:
            yield SourceCost("distance from the prediction", state.prediction_error, nan)

    def fixed(self, state: State, whole: float) -> dict[str, float]:
        """Return the errors of the terms that no knob reduces, if they count in a whole error."""
        lowered = {term for knob in self.knobs for term in (*knob.terms, *knob.lowers)}
        errors = {
            term: float(np.max(half))
            for term, half in state.half_width.items()
            if term not in lowered or state.falls.get(term, 1.0) < LEAST_FALL
        }
        largest = sorted(errors.items(), key=lambda item: -item[1])
        return {term: error for term, error in largest if error > NEGLIGIBLE * whole}

    def _refuse_floor(self, state: State) -> None:
        """Refuse a target below the terms that no knob reduces."""
        if not (every := self.fixed(state, 0.0)):
            return
        floor = float(np.max(np.linalg.norm([state.half_width[term] for term in every], axis=0)))
        if floor > self.target:
            fixed = {term: error for term, error in every.items() if error > NEGLIGIBLE * floor}
            named = " and ".join(f"{term} ({100.0 * error:.2g} %)" for term, error in fixed.items())
            raise CaseError(
                f"an error of {100.0 * self.target:.3g} % is out of reach: no setting of the case "
                f"reduces {named}; ask for more than {100.0 * floor:.2g} %, or change what that "
                f"comes from"
            )

    def _reason(self, state: State, error: float, rounds: int) -> str:
        """Report why no further setting is solved."""
        aimed = self.cheapest(state, AIM * self.target, inf)
        more = f"; a setting for it takes about {aimed.expected_seconds:.3g} s" if aimed else ""
        why = "no step that lowers it fits into the time"
        if rounds == MOST_ROUNDS:
            why = f"{MOST_ROUNDS} rounds are over"
        elif self.choose(state, inf) is None:
            largest = max(self.sources(state), key=lambda source: source.error)
            why = (
                f"no further setting of the case lowers it; its largest part is {largest.name} "
                f"({100.0 * largest.error:.2g} %)"
            )
        return (
            f"the error is {100.0 * error:.3g} %, above the target of {100.0 * self.target:.3g} %, "
            f"and {why}{more}"
        )


def halving_seconds(
    seconds: Mapping[str, float], powers: Mapping[str, float], order: float, adds: bool
) -> float:
    """Return the time in which a knob halves its error, s; 0 if its stages have no time yet."""
    moved = {stage: power for stage, power in powers.items() if power and seconds.get(stage)}
    grown = sum(seconds[stage] * 2.0 ** (power / order) for stage, power in moved.items())
    return float(grown - (sum(seconds[stage] for stage in moved) if adds else 0.0))


def _left(
    knob: Knob,
    difference: np.ndarray,
    rung: int,
    old: KnobError | None,
    chance: np.ndarray,
    ratio: float,
) -> KnobError:
    """Return the error that a knob leaves by (1)."""
    low, high = knob.orders
    nothing, first = np.zeros(difference.shape), 1.0 / (ratio**low - 1.0)
    if knob.scatters:
        middle = 0.5 * first * difference
        return KnobError(middle, np.abs(middle), first * chance, low, difference, rung)
    size = np.maximum(np.abs(difference), np.sqrt(np.mean(difference**2)))
    order = _order(knob, difference, rung, old, ratio)
    if not low - BELOW <= order <= high + ABOVE:
        return KnobError(nothing, first * size, nothing, nan, difference, rung)
    near = float(np.clip(order, low, high))
    most, least = (
        1.0 / (ratio**bound - 1.0) for bound in (max(low, near - NEAR), min(high, near + NEAR))
    )
    middle, half = 0.5 * (most + least), 0.5 * (most - least)
    return KnobError(middle * difference, half * size, nothing, order, difference, rung)


def _order(
    knob: Knob, difference: np.ndarray, rung: int, old: KnobError | None, ratio: float
) -> float:
    """Return the order by two differences, the order seen before, or a narrow range's middle."""
    low, high = knob.orders
    if old is not None and rung > old.rung:
        earlier = _on(old.difference, difference)
        if float(earlier @ difference) <= 0.0 or ratio < CLEAR_RATIO:
            return nan
        fall = np.linalg.norm(earlier) / np.linalg.norm(difference)
        return float(np.log(fall) / np.log(ratio)) / (rung - old.rung)
    if old is not None:
        return old.order
    return 0.5 * (low + high) if high - low < NARROW else nan


def _expected_order(knob: Knob, left: KnobError) -> float:
    """Return the order by which an error is expected to fall."""
    low, high = knob.orders
    return float(np.clip(left.order, low, high)) if isfinite(left.order) else 0.5 * (low + high)


def _on(values: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return values at the places of others, which may be more."""
    if values.shape == others.shape:
        return values
    places = np.linspace(0.0, 1.0, others.size)
    return np.asarray(np.interp(places, np.linspace(0.0, 1.0, values.size), values))


def _rungs(setting: Setting) -> str:
    """Return a setting in words."""
    moved = ", ".join(f"{name} {rung:+d}" for name, rung in setting.items() if rung)
    return moved or "the case as it is given"


def _line(number: int, done: Round) -> str:
    """Return the sentence of a round."""
    expected = ""
    if isfinite(done.expected_error):
        expected = (
            f", {100.0 * done.expected_error:.3g} % and {done.expected_seconds:.3g} s expected"
        )
    return (
        f"round {number}: {_rungs(done.setting)}; error {100.0 * done.error:.3g} % "
        f"after {done.seconds:.3g} s{expected}"
    )

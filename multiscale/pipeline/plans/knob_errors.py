r"""An answer at a setting: errors that knobs leave in it, errors and times of finer settings.

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
measured by the same differences.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite, log2, nan

import numpy as np

from multiscale.pipeline.plans.knobs import HIGHEST, CaseKnob, Setting
from multiscale.upscaling.budget import total_error

NARROW = 0.5  # width of a range of orders that is taken without two differences
BELOW, ABOVE = 0.5, 0.7  # distance of an observed order from its range, at most
NEAR = 0.5  # distance of an order from the observed order, at most
CLEAR_RATIO = 1.8  # of spacings, below which two differences show no order
MINOR = 0.05
"""Error of a knob over the target below which it is not measured again at the next setting, and of
a term over a whole error below which it is not named."""

LEAST_FALL, SEEN = 0.1, 2
"""Power of two from rung to rung below which a knob does not lower a term, over so many rungs."""

SAMPLING = "sampling"


@dataclass(frozen=True, eq=False)
class Outcome:
    """An answer at a setting."""

    value: np.ndarray  # shape (places,), any unit
    half_width: Mapping[str, np.ndarray]  # by terms, relative; empty without a budget
    seconds: Mapping[str, float]  # of the stages, s
    bias: Mapping[str, np.ndarray] = field(default_factory=dict)  # with signs, by terms likewise
    ratio: Mapping[str, float] = field(default_factory=dict)  # r in (1) by knobs, if it is not 2


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
            correction=at_places(self.correction, values),
            bias=at_places(self.bias, values),
            noise=at_places(self.noise, values),
            difference=at_places(self.difference, values),
        )


@dataclass(frozen=True)
class SourceCost:
    """Error that a source leaves, and the seconds that halve it."""

    name: str
    error: float
    seconds: float


@dataclass(frozen=True, eq=False)
class PlanState:
    """An answer at a setting, with the errors that its knobs leave."""

    knobs: Sequence[CaseKnob]
    setting: Setting
    outcome: Outcome
    left: Mapping[str, KnobError] = field(default_factory=dict)
    growth: Mapping[tuple[str, str], float] = field(default_factory=dict)
    """Power of two by stage and knob."""
    falls: Mapping[str, float] = field(default_factory=dict)
    """Powers of two by which terms in ``lowers`` of knobs fell."""
    first: "PlanState | None" = None  # of the plan
    prediction_error: float = 0.0  # distance from the prediction, relative

    @property
    def replaced(self) -> set[str]:
        """Terms of the budget that measured knobs replace."""
        return {term for knob in self.knobs if knob.measured for term in knob.terms}

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

    def error(self, up: Setting | None = None) -> np.ndarray:
        """Return the error of the answer, or the error expected so many rungs higher."""
        up, rung = up or {}, {knob.name: knob for knob in self.knobs}
        square = np.zeros(self.outcome.value.shape)
        for term, half in self.half_width.items():
            square = square + (2.0 ** -self._fall(up, term) * half) ** 2
        bias, chance = np.full(square.shape, self.prediction_error), self._fall(up, SAMPLING)
        for name, left in self.left.items():
            fall = _expected_order(rung[name], left) * up.get(name, 0)
            # a difference within its chance is expected to fall as the chance does
            falls = np.where(left.bias <= 0.5 * left.noise, np.maximum(fall, chance), fall)
            bias = bias + 2.0**-falls * left.bias + 2.0**-chance * left.noise
        return total_error(bias, np.sqrt(square))

    def _fall(self, up: Setting, term: str) -> float:
        """Return the power of two by which a term is expected to fall so many rungs higher."""
        fall = 0.0
        for knob in self.knobs:
            power = knob.draws if term == SAMPLING else 0.0
            if term in (*knob.terms, *knob.lowers):
                power += self.falls.get(term, knob.orders[0])
            fall += power * up.get(knob.name, 0)
        return fall

    def falls_from(self, first: "PlanState") -> dict[str, float]:
        """Return the powers of two by which terms that knobs should lower fall from rung to rung.

        Terms of few cells have a chance, which a single rung may hide their fall in.
        """
        falls = {}
        for knob in self.knobs:
            rungs = self.setting[knob.name] - first.setting[knob.name]
            for term in knob.lowers if rungs >= SEEN else ():
                new, old = (
                    float(np.max(state.outcome.half_width.get(term, 0.0)))
                    for state in (self, first)
                )
                if old > 0.0 and new > 0.0:
                    falls[term] = max(log2(old / new) / rungs, 0.0)
        return falls

    def matters(self, knob: CaseKnob) -> bool:
        """Whether a knob has an error worth lowering."""
        if knob.name in self.left:
            return bool(np.max(self.left[knob.name].bias) > 0.0)
        lowered = (*knob.terms, *knob.lowers)
        return any(np.any(self.half_width.get(term, 0.0)) for term in lowered)

    def is_settled(self, knob: CaseKnob, target: float) -> bool:
        """Whether the error of a knob is too small to be measured again at its rung."""
        left, bound = self.left.get(knob.name), target if isfinite(target) else 0.0
        return left is not None and left.size < MINOR * bound

    def seconds(self, up: Setting, target: float) -> float:
        """Forecast the seconds of the next round: the answer, and its coarsened settings."""
        total, higher = 0.0, {name: rung + up[name] for name, rung in self.setting.items()}
        for stage, now in self.outcome.seconds.items():
            power = {knob: self._power(stage, knob) for knob in self.knobs}
            there = now * 2.0 ** sum(power[knob] * up[knob.name] for knob in self.knobs)
            raised = [knob for knob in self.knobs if up[knob.name] and power[knob]]
            stored = any(knob.adds and stage in knob.costs for knob in self.knobs)
            further = stored and all(knob.adds for knob in raised)
            new = there - now if further else there  # further cells only, or all
            total += new
            for knob in self.knobs:
                again = knob.measured and (up[knob.name] or not self.is_settled(knob, target))
                if again and (power[knob] or not stored):
                    more = time_of_more(further_cells(self.knobs, knob, higher), stage)
                    total += new * 2.0 ** (more - power[knob])
        return total

    def _power(self, stage: str, knob: CaseKnob) -> float:
        return self.growth.get((stage, knob.name), knob.costs.get(stage, 0.0))

    def sources(self) -> Iterator[SourceCost]:
        """Yield every source of error with the seconds that halve it."""

        def halving(knob: CaseKnob | None, order: float) -> float:
            if knob is None:
                return nan
            seconds = self.outcome.seconds
            powers = {stage: self._power(stage, knob) for stage in seconds}
            return halving_seconds(seconds, powers, order, knob.adds)

        for term, half in self.half_width.items():
            knob = next((k for k in self.knobs if term in (*k.terms, *k.lowers)), None)
            seconds = halving(knob, knob.orders[0] if knob else nan)
            yield SourceCost(term, float(np.max(half)), seconds)
        for knob in self.knobs:
            if knob.name in self.left:
                left = self.left[knob.name]
                yield SourceCost(knob.name, left.size, halving(knob, _expected_order(knob, left)))
        if self.prediction_error:
            yield SourceCost("distance from the prediction", self.prediction_error, nan)

    def fixed(self, whole: float) -> dict[str, float]:
        """Return the errors of the terms that no knob reduces, if they count in a whole error."""
        lowered = {term for knob in self.knobs for term in (*knob.terms, *knob.lowers)}
        errors = {
            term: float(np.max(half))
            for term, half in self.half_width.items()
            if term not in lowered or self.falls.get(term, 1.0) < LEAST_FALL
        }
        largest = sorted(errors.items(), key=lambda item: -item[1])
        return {term: error for term, error in largest if error > MINOR * whole}


def halving_seconds(
    seconds: Mapping[str, float], powers: Mapping[str, float], order: float, adds: bool
) -> float:
    """Return the time in which a knob halves its error, s; 0 if its stages have no time yet."""
    moved = {stage: power for stage, power in powers.items() if power and seconds.get(stage)}
    grown = sum(seconds[stage] * 2.0 ** (power / order) for stage, power in moved.items())
    return float(grown - (sum(seconds[stage] for stage in moved) if adds else 0.0))


def further_cells(
    knobs: Sequence[CaseKnob], knob: CaseKnob, setting: Setting
) -> dict[CaseKnob, int]:
    """Return the rungs by which cells of the rung below a knob are more, as they scatter more.

    So many have the scatter of the rung, and take less time; there are none above the highest rung.
    """
    adding = [cells for cells in knobs if cells.adds and knob.scatters]
    return {
        cells: max(min(round(knob.draws / cells.orders[0]), HIGHEST - setting[cells.name]), 0)
        for cells in adding
    }


def time_of_more(further: Mapping[CaseKnob, int], stage: str) -> float:
    """Return the power of two by which these cells take more time."""
    return sum(rungs * cells.costs.get(stage, 0.0) for cells, rungs in further.items())


def measure_growth(
    knob: CaseKnob,
    further: Mapping[CaseKnob, int],
    fine: Mapping[str, float],
    coarse: Mapping[str, float],
) -> dict[tuple[str, str], float]:
    """Return the powers of two by which the seconds of stages grow with a knob."""
    powers = {}
    for stage, seconds in fine.items():
        less = coarse.get(stage, 0.0) * 2.0 ** -time_of_more(further, stage)
        if seconds > 0.0 and less > 0.0:
            powers[stage, knob.name] = float(np.clip(log2(seconds / less), 0.0, 4.0))
    return powers


def measure_error(
    knob: CaseKnob,
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
    knob: CaseKnob, difference: np.ndarray, rung: int, old: KnobError | None, ratio: float
) -> float:
    """Return the order by two differences, the order seen before, or a narrow range's middle."""
    low, high = knob.orders
    if old is not None and rung > old.rung:
        earlier = at_places(old.difference, difference)
        if float(earlier @ difference) <= 0.0 or ratio < CLEAR_RATIO:
            return nan
        fall = np.linalg.norm(earlier) / np.linalg.norm(difference)
        return float(np.log(fall) / np.log(ratio)) / (rung - old.rung)
    if old is not None:
        return old.order
    return 0.5 * (low + high) if high - low < NARROW else nan


def _expected_order(knob: CaseKnob, left: KnobError) -> float:
    """Return the order by which an error is expected to fall."""
    low, high = knob.orders
    return float(np.clip(left.order, low, high)) if isfinite(left.order) else 0.5 * (low + high)


def at_places(values: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return values at the places of others, which may be more."""
    if values.shape == others.shape:
        return values
    places = np.linspace(0.0, 1.0, others.size)
    return np.asarray(np.interp(places, np.linspace(0.0, 1.0, values.size), values))

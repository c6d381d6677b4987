"""The planner reaches its target near the best fixed setting, without a loss of time."""

from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from multiscale.errors import CaseError, ConvergenceError
from multiscale.io.datasets import open_run
from multiscale.micro.layer import graded_planes
from multiscale.pipeline import load_case, run
from multiscale.pipeline.costs import cost_section, stage_seconds
from multiscale.pipeline.plans.case_knobs import body_knobs, cell_knobs
from multiscale.pipeline.plans.knob_errors import KnobError, Outcome, SourceCost, halving_seconds
from multiscale.pipeline.plans.knobs import CaseKnob, scaled
from multiscale.pipeline.plans.planner import Planner
from multiscale.pipeline.verification import verify_run
from multiscale.upscaling.budget import MACRO, total_error
from tests.support import case_text

CASE = case_text("planned")
TRUTH = np.array([3.0, 5.0])
SCATTER = 0.1  # of a cell


def NO_CASE(case, rung):
    return case


@pytest.mark.parametrize(("least", "lowest"), [(1, -2), (2, -1), (4, 0)])
def test_the_lowest_rung_is_the_last_that_a_case_accepts(least, lowest):
    def change(case, rung):
        if case * 2.0**rung < least:
            raise CaseError("too coarse")
        return case * 2.0**rung

    knob = CaseKnob("points", change, measured=False)
    assert knob.lowest(4.0) == lowest
    assert knob.applies(4.0)
    assert CaseKnob("points", lambda case, rung: change(case, min(rung, 0))).applies(4.0) == (
        least < 4
    )


@dataclass
class Synthetic:
    """A structure with errors of order 1.8 and 1 by two knobs, and cells with a scatter."""

    seed: int
    slopes: float = 0.0  # half-width that no knob reduces
    bias: float = 0.0  # of the same term, about which this half-width is
    refused: int = 99  # rung of the elements
    spent: float = 0.0
    cells: int = 0

    def error(self, v):
        return -0.1 * 2.0 ** (-1.8 * v["elements"]) + 0.04 * 2.0 ** -v["steps"]

    def seconds(self, v):
        structure = 2.0 ** (1.5 * v["elements"] + v["steps"])
        return {"structure": structure, "cells": 0.4 * 2.0 ** v["cells"]}

    def __call__(self, v, whole):
        if v["elements"] >= self.refused:
            raise CaseError("the mesh has no such elements")
        n = 8 * 2 ** v["cells"]
        drawn = np.random.default_rng(self.seed).standard_normal(8192)[:n]
        self.spent += self.seconds(v)["structure"] + 0.05 * max(n - self.cells, 0)
        self.cells = max(self.cells, n)
        half = np.full(2, 1.96 * SCATTER / np.sqrt(n))
        terms = {"sampling": half, "small slopes": np.full(2, self.slopes)}
        value = TRUTH * (1.0 + self.error(v)) * (1.0 + SCATTER * drawn.mean()) / (1.0 - self.bias)
        bias = {"small slopes": np.full(2, self.bias), "sampling": np.full(2, np.nan)}
        return Outcome(value, terms if whole else {}, self.seconds(v), bias)

    def knobs(self):
        return [
            CaseKnob("cells", NO_CASE, ("sampling",), (0.5, 0.5), {"cells": 1.0}, False, adds=True),
            CaseKnob("elements", NO_CASE, costs={"structure": 3.0}),
            CaseKnob("steps", NO_CASE, costs={"structure": 3.0}),
        ]

    def plan(self, target, **limits):
        lowest = {"cells": 0, "elements": -2, "steps": -2}
        planner = Planner(self.knobs(), self, lowest, target, spent=lambda: self.spent, **limits)
        return planner, planner.run()


def best_fixed(target):
    """Seconds of the cheapest setting, taken with the errors known and without cancelling signs."""
    stage, times = Synthetic(0), []
    for rungs in product(range(9), range(-2, 7), range(-2, 7)):
        v = dict(zip(("cells", "elements", "steps"), rungs, strict=True))
        bias = 0.1 * 2.0 ** (-1.8 * v["elements"]) + 0.04 * 2.0 ** -v["steps"]
        half = 1.96 * SCATTER / np.sqrt(8 * 2 ** v["cells"])
        if total_error(bias, half) <= target:
            times.append(sum(stage.seconds(v).values()))
    return min(times)


@dataclass
class Sizes:
    """Eight cells or more of every size, with scatter and an error of order 1."""

    seed: int
    effect: float = 0.0
    stored: dict[float, int] = field(default_factory=dict)  # cells by their edges

    @property
    def spent(self):
        return sum(edge**2 * n / 8.0 for edge, n in self.stored.items())

    def best_fixed(self, target):
        """Seconds of the cheapest setting, taken with the errors known."""
        settings = product(2.0 ** np.arange(-2, 7), 8 * 2 ** np.arange(9))
        return min(
            edge**2 * n / 8.0
            for edge, n in settings
            if total_error(abs(self.effect) / edge, 1.96 * SCATTER / np.sqrt(n) / edge) <= target
        )

    def __call__(self, v, whole):
        edge, n = 2.0 ** v["size"], 8 * 2 ** v.get("cells", 0)
        self.stored[edge] = max(n, self.stored.get(edge, 0))
        drawn = np.random.default_rng((self.seed, v["size"] + 2)).standard_normal(n).mean()
        half = {"sampling": np.full(1, 1.96 * SCATTER / np.sqrt(n) / edge)}
        value = np.array([1.0 + self.effect / edge + SCATTER * drawn / edge])
        return Outcome(value, half, {"cells": edge**2 * n / 8.0})


@pytest.mark.parametrize("target", [0.1, 0.05, 0.02])
def test_targets_and_stated_errors_are_met_near_the_best_fixed_setting(target):
    below, fixed, times = 0, 0, []
    for seed in range(20):
        stage = Synthetic(seed)
        _, reached = stage.plan(target)
        error = np.max(np.abs(reached.state.value / TRUTH - 1.0))
        assert reached.error.max() <= target
        below, fixed = below + (error <= target), fixed + (error <= reached.error.max())
        times.append(stage.spent)
    assert min(below, fixed) >= 18
    assert np.median(times) <= 3.0 * best_fixed(target)


@pytest.mark.parametrize(("ratio", "order"), [(1.4, 1.0), (1.4, 2.0), (1.9, 1.0)])
def test_an_error_follows_from_the_ratio_of_the_spacings(ratio, order):
    """Of a value 1 + spacing ** order; no order is seen between meshes that hardly differ."""

    def solve(v, whole):
        value = np.array([1.0 + 0.1 * ratio ** (-order * v["elements"])])
        return Outcome(value, {}, {"structure": 1.0}, ratio={"elements": ratio})

    planner = Planner([CaseKnob("elements", NO_CASE)], solve, {"elements": 0})
    state = planner.measure({"elements": 2}, planner.measure({"elements": 1}, None))
    assert np.isfinite(state.left["elements"].order) == (ratio > 1.8)
    np.testing.assert_array_less(abs(1.0 - 1.0 / state.value), 1.05 * state.error())


def test_plans_of_a_lap_joint_begin_with_meshes_that_differ():
    """Its hole has so many elements that those of 8 mm and 16 mm are the same."""
    case = load_case("bolted_lap")
    knob = next(knob for knob in body_knobs(case) if knob.name == "elements")
    assert knob.ratio(knob.change(case, -1)) == 1.0
    assert 1.2 < knob.ratio(case) < 2.0
    assert knob.lowest(case) == -1
    assert knob.lowest(knob.change(case, -2)) == 1


@pytest.mark.parametrize(("coarser", "terms"), [(None, ()), (Path("coarse.msh"), (MACRO,))])
def test_meshes_of_files_leave_the_rungs_of_other_bodies(coarser, terms):
    """Their error is in the budget if all have a coarser mesh, and is unknown otherwise."""
    case = load_case("holed_strip")
    (strip,), plain = case.structure.bodies, next(body_knobs(case))
    file = {"name": "block", "element": None, "mesh": Path("block.msh"), "coarser": coarser}
    bodies = {"bodies": (strip, strip.model_copy(update=file))}
    mixed = case.model_copy(update={"structure": case.structure.model_copy(update=bodies)})
    knob = next(body_knobs(mixed))
    assert (knob.terms, knob.measured) == (terms, coarser is None)
    assert knob.ratio(mixed) == plain.ratio(case) > 1.2
    assert knob.lowest(mixed) + knob.measured == 0  # the rung that is solved first


def test_meshes_that_never_differ_have_no_error():
    with pytest.raises(CaseError, match=r"^the elements of all settings .* are the same"):
        CaseKnob("elements", NO_CASE, ratio=lambda case: 1.0).lowest(1.0)
    same = Outcome(TRUTH, {}, {}, ratio={"elements": 1.0})
    planner = Planner([CaseKnob("elements", NO_CASE)], lambda v, whole: same, {"elements": 0})
    with pytest.raises(
        CaseError, match=r"the elements at the setting elements \+1 and at the coar"
    ):
        planner.run()


def test_fewer_cells_leave_enough_for_their_scatter():
    case = load_case("bolted_lap")
    cells = next(knob for knob in cell_knobs(case) if knob.name == "cells")
    assert cells.change(case, 0) == case
    sheared = [cells.change(case, rung).micro.shear.realisations for rung in (0, 1)]
    assert sheared == [4, 8]
    few = case.micro.model_copy(update={"realisations": 16})
    few = cells.change(case.model_copy(update={"micro": few}), -1)
    assert (few.micro.realisations, few.micro.shear.realisations) == (8, 3)
    two = case.model_copy(update={"micro": case.micro.model_copy(update={"realisations": 2})})
    counts = [cells.change(two, rung).micro.realisations for rung in (0, 1, 2)]
    assert counts == [4, 8, 16]  # a rung is a factor of two, also with the fewest


def test_the_cost_of_a_round_follows_the_measured_growth():
    """The knobs state a power of 3, and the stage has 1.5 and 1."""
    _, reached = Synthetic(1).plan(0.02)
    for done in reached.rounds[1:]:
        assert done.expected_seconds == pytest.approx(done.seconds, rel=1e-9)
    growth = reached.state.growth
    assert growth["structure", "elements"] == pytest.approx(1.5)
    assert growth["structure", "steps"] == pytest.approx(1.0)


@pytest.mark.parametrize("seconds", [0.5, 5.0])
def test_the_time_of_cells_includes_their_files_and_cells_of_earlier_runs(seconds):
    from multiscale.pipeline.stages.cells import CELLS

    cells = xr.Dataset({"wall_time": ("realisation", [1.0, 2.0])}, attrs={"seconds": seconds})
    assert stage_seconds({CELLS.name: cells}, [CELLS]) == {CELLS.name: max(seconds, 3.0)}


def test_seen_orders_are_extrapolated():
    _, reached = Synthetic(2).plan(0.02)
    assert reached.state.left["elements"].order == pytest.approx(1.8, abs=0.05)
    assert reached.state.left["steps"].order == pytest.approx(1.0, abs=0.3)  # elements change, too
    # the correction is better than the value
    sampled = Synthetic(2)(reached.state.setting, True).value / TRUTH
    exact = sampled / (1.0 + Synthetic(2).error(reached.state.setting))
    np.testing.assert_allclose(reached.state.value / TRUTH, exact, rtol=0.01)


@pytest.mark.parametrize("target", [0.15, 0.05])
@pytest.mark.parametrize("effect", [0.0, -0.05, 0.08, 0.12, 0.2])
def test_stated_errors_hold_effects_of_the_size_of_cells_within_their_scatter(effect, target):
    cells, *_ = Synthetic(0).knobs()
    size = CaseKnob("size", NO_CASE, ("cell size",), costs={"cells": 2.5}, scatters=True, draws=1.0)
    held, times = [], []
    for seed in range(120):
        stage = Sizes(seed, effect)
        reached = Planner([cells, size], stage, {"cells": 0, "size": -2}, target).run()
        assert reached.error.max() <= target
        held.append(abs(reached.state.value[0] - 1.0) <= reached.error[0])
        times.append(stage.spent)
    assert np.mean(held) >= 0.9
    if abs(effect) > target:  # where it need not be shown to be small
        assert np.median(times) <= 6.0 * stage.best_fixed(target)


@dataclass
class Windows(Sizes):
    """Cells of a map, which has room for a number of them."""

    most: int = 8

    def __call__(self, v, whole):
        if 8 * 2 ** v["cells"] > self.most:
            raise CaseError("the map has no room for so many cells")
        return super().__call__(v, whole)


@pytest.mark.parametrize(
    ("cells", "most", "variance"), [(6, 512, 5.0), (5, 512, 3.0), (0, 8, 5.0), (0, 32, 2.0)]
)
def test_smaller_cells_are_as_many_as_the_highest_rung_and_the_case_have(cells, most, variance):
    knob = CaseKnob("size", NO_CASE, ("cell size",), costs={"cells": 3.0}, scatters=True, draws=1.0)
    planner = Planner([Synthetic(0).knobs()[0], knob], Windows(0, most=most), {})
    state = planner.measure({"cells": cells, "size": 0}, None)
    half_width = state.outcome.half_width["sampling"][0]
    assert state.left["size"].noise[0] == pytest.approx(half_width * np.sqrt(variance))
    assert state.growth["cells", "size"] == pytest.approx(2.0)


@pytest.mark.parametrize("adding", [0, 1])
def test_the_chance_of_cells_of_two_sizes_is_not_an_error_of_their_size(adding):
    """A 95 % half-width holds 95 % of the differences, and seconds grow by their power.

    If cells can be added, four times as many of half the size have the same scatter.
    """
    cells = Synthetic(0).knobs()[:adding]
    knob = CaseKnob("size", NO_CASE, ("cell size",), costs={"cells": 3.0}, scatters=True, draws=1.0)
    states = [
        Planner([*cells, knob], Sizes(k), {}).measure({"cells": 0, "size": 0}, None)
        for k in range(500)
    ]
    left = [state.left["size"] for state in states]
    beyond = np.mean([abs(each.difference[0]) > each.noise[0] for each in left])
    half_width = states[0].outcome.half_width["sampling"][0]
    assert left[0].noise[0] == pytest.approx(half_width * np.sqrt(2.0 if adding else 5.0))
    assert 0.02 < beyond < 0.08
    assert states[0].growth["cells", "size"] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("term", "target", "sentence"),
    [
        ({"slopes": 0.08}, 0.05, r"5 % is out of reach: .* reduces small slopes \(8 %\)"),
        # hardly a part of the error of the first answer, of 7 % by sampling
        ({"slopes": 0.003}, 0.002, r"0\.2 % is out of reach: .* small slopes \(0\.3 %\)"),
    ],
)
def test_a_target_below_a_term_without_a_knob_names_it(term, target, sentence):
    stage, first = Synthetic(0, **term), Synthetic(0)
    with pytest.raises(CaseError, match=sentence):
        stage.plan(target)
    first({"cells": 0, "elements": -1, "steps": -1}, True)
    assert stage.spent == first.spent  # before coarser settings are solved


@pytest.mark.parametrize("bias", [0.08, -0.08])
def test_a_bias_of_the_budget_is_taken_out_of_the_answer(bias):
    plain, biased = (Synthetic(0, bias=b).plan(0.05)[1] for b in (0.0, bias))
    np.testing.assert_allclose(biased.state.value, plain.state.value, rtol=1e-12)
    np.testing.assert_allclose(biased.error, plain.error, rtol=1e-12)
    assert abs(biased.state.outcome.value / plain.state.outcome.value - 1.0)[0] > 0.05


@pytest.mark.parametrize(
    ("surface", "stopped"),
    [
        ([0.08, 0.04, 0.02], ""),
        ([0.08, 0.056, 0.04, 0.028], ""),
        ([0.08, 0.082, 0.02], ""),  # by chance, as of few windows of a map
        ([0.08] * 9, "3 % is out of reach: no setting of the case reduces surface (8 %)"),
    ],
)
def test_a_term_falls_as_two_rungs_show(surface, stopped):
    """A knob that should halve a term from rung to rung; the plan ends where it does not."""

    def solve(v, whole):
        return Outcome(np.ones(1), {"surface": surface[v["size"]] * np.ones(1)}, {"cells": 1.0})

    knob = CaseKnob("size", NO_CASE, measured=False, orders=(1.0, 1.0), lowers=("surface",))
    reached = Planner([replace(knob, scatters=True)], solve, {"size": 0}, 0.03).run()
    assert (reached.error.max() <= 0.03) == (not stopped)
    assert reached.stopped.startswith(f"an error of {stopped}" if stopped else "")


def test_an_answer_that_is_not_known_at_coarser_settings_has_no_error():
    class Unknown(Synthetic):
        def __call__(self, v, whole):
            done = super().__call__(v, whole)
            return done if whole else replace(done, value=np.array([1.0, np.nan]))

    with pytest.raises(CaseError, match=r"coarser setting elements -2, steps -1 is not known"):
        Unknown(0).plan(0.05)


def test_terms_without_a_knob_are_sources_that_no_time_halves():
    _, reached = Synthetic(0, slopes=0.01).plan(0.05)
    assert reached.state.fixed(0.05) == {"small slopes": pytest.approx(0.01)}
    times = {source.name: source.seconds for source in reached.sources}
    assert np.isnan(times["small slopes"])
    assert reached.state.fixed(0.5) == {}  # hardly counts
    cells = Synthetic(0).seconds(reached.state.setting)["cells"]
    assert times["sampling"] == pytest.approx(3.0 * cells)  # four times as many


def test_a_refused_rung_ends_its_ladder():
    stage = Synthetic(0, refused=2)
    _, reached = stage.plan(0.05)
    assert reached.state.setting["elements"] < 2
    with pytest.raises(CaseError, match="no such elements"):
        Synthetic(0, refused=-2).plan(0.05)


def test_a_rung_without_an_answer_leaves_the_last_answer():
    class Diverging(Synthetic):
        def __call__(self, v, whole):
            if v["elements"] >= self.refused:
                raise ConvergenceError("the structure does not converge")
            return super().__call__(v, whole)

    lines = []
    _, reached = Diverging(0, refused=0).plan(0.02, report=lines.append)
    assert reached.state.setting["elements"] == -1
    sentence = "the setting steps -1 has no answer: the structure does not converge"
    assert sentence in lines
    assert reached.stopped.endswith(sentence)
    with pytest.raises(ConvergenceError):
        Diverging(0, refused=-2).plan(0.05)


def test_smaller_steps_lead_to_an_answer_that_larger_steps_do_not_have():
    class Steep(Synthetic):
        def knobs(self):
            cells, elements, steps = super().knobs()
            return [cells, elements, replace(steps, eases=True)]

        def __call__(self, v, whole):
            if v["elements"] > v["steps"] + 1:
                raise ConvergenceError("the structure does not converge")
            return super().__call__(v, whole)

    _, reached = Steep(0).plan(0.02)
    assert reached.error.max() <= 0.02


def test_a_first_setting_without_an_answer_is_followed_by_a_finer_setting():
    class Coarse(Synthetic):
        def __call__(self, v, whole):
            if v["elements"] < -1:
                raise ConvergenceError("the structure does not converge")
            return super().__call__(v, whole)

    lines = []
    _, reached = Coarse(0).plan(0.05, report=lines.append)
    assert reached.error.max() <= 0.05
    assert lines[0].startswith("the setting elements -1, steps -1 has no answer: the structure")
    assert "round 1: the given case;" in lines[1]


def test_a_refused_rung_does_not_end_other_ladders():
    _, reached = Synthetic(0, refused=0).plan(0.02)
    assert reached.stopped
    assert reached.state.setting["elements"] == -1
    assert min(reached.state.setting[name] for name in ("cells", "steps")) > 0


def test_the_last_round_has_an_answer(monkeypatch):
    monkeypatch.setattr("multiscale.pipeline.plans.planner.MOST_ROUNDS", 2)
    _, reached = Synthetic(0).plan(0.01)
    assert len(reached.rounds) == 2
    assert reached.stopped.startswith(f"the error is {100.0 * reached.error.max():.3g} %")
    assert reached.stopped.endswith("2 rounds are over")


def test_a_short_time_ends_with_the_answer_and_the_time_of_the_target():
    _, reached = Synthetic(0).plan(0.02, time=10.0)
    assert 0.02 < reached.error.max() < 1.0
    assert sum(done.seconds for done in reached.rounds) <= 10.0
    assert "above the target of 2 %" in reached.stopped


def test_time_without_a_target_is_used_for_the_least_error():
    errors = [Synthetic(0).plan(np.inf, time=time)[1].error.max() for time in (5.0, 50.0, 500.0)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.02


def test_the_time_that_halves_an_error_follows_from_order_and_growth():
    seconds = {"cells": 3.0, "structure": 10.0}
    assert halving_seconds(seconds, {"structure": 3.0}, 1.5, False) == pytest.approx(40.0)
    assert halving_seconds(seconds, {"cells": 1.0}, 0.5, True) == pytest.approx(9.0)


def test_a_source_without_time_is_not_a_source_without_a_setting():
    """0 s of stages that were read from files, NaN without a knob."""
    assert halving_seconds({"cells": 0.0}, {"cells": 1.0}, 0.5, True) == 0.0
    costs = [SourceCost("sampling", 0.1, 0.0), SourceCost("surface", 0.1, np.nan)]
    rows = cost_section({"cells": 1.0}, costs, "gap").rows
    assert [row[-1] for row in rows] == ["", "not known", "no setting reduces it"]


@pytest.fixture
def write(tmp_path):
    def _write(text, name="case"):
        file = tmp_path / f"{name}.toml"
        file.write_text(text, encoding="utf-8")
        return load_case(file)

    return _write


def test_cells_of_other_rungs_keep_their_spacing_or_surface(write):
    case = write(CASE.replace("[32, 32]", "[64, 64]"))
    knobs = {knob.name: knob for knob in cell_knobs(case)}
    larger = knobs["size of the cells"].change(case, 1)
    assert (larger.cell.size, larger.cell.points) == ((4e-3, 4e-3), (128, 128))
    assert larger.body_1 == case.body_1
    assert larger.micro.seed != case.micro.seed
    finer = knobs["points of the cells"].change(case, -1)
    assert (finer.cell.size, finer.cell.points) == (case.cell.size, (32, 32))
    assert finer.micro.seed == case.micro.seed
    assert knobs["cells"].change(case, 2).micro.realisations == 16
    assert len(knobs["pressures"].change(case, 1).micro.pressures) == 5
    for knob in knobs.values():
        assert knob.change(case, 0) == case
        changed = knob.change(case, 1)  # as its folder has it in a file
        assert write(changed.to_toml(), "again").identity() == changed.identity()


def test_layers_of_larger_and_finer_cells_are_graded_alike(write):
    """Thickness grows from layer to layer by one factor, which a finer grid takes in two steps."""
    case = write(CASE.replace("layers = 8", "layers = 24").replace("[32, 32]", "[64, 64]"))
    knobs = {knob.name: knob for knob in cell_knobs(case)}

    def growth(name, rung):
        cell = knobs[name].change(case, rung).cell
        planes = graded_planes(cell.size[0], cell.layers, cell.spacing)
        return (planes[1] / np.diff(planes)[-1]) ** (1.0 / (cell.layers - 1))

    size, points = "size of the cells", "points of the cells"
    given = growth(size, 0)
    np.testing.assert_allclose([growth(size, rung) for rung in (-1, 1, 2)], given, rtol=0.03)
    np.testing.assert_allclose(growth(points, 1) ** 2, given, rtol=0.03)


def test_surfaces_with_all_wavelengths_have_cells_of_other_points(write):
    """As maps without a short_cutoff, which a run with a budget may have."""
    case = write(CASE.replace("[32, 32]", "[64, 64]"))
    surface = case.body_1.surface.model_copy(update={"short_cutoff": None})
    case = case.model_copy(update={"body_1": case.body_1.model_copy(update={"surface": surface})})
    knob = next(knob for knob in cell_knobs(case) if knob.name == "points of the cells")
    assert knob.applies(case)
    with pytest.raises(CaseError, match="4 points along an edge are too few"):
        knob.change(case, -4)


def test_more_cells_do_not_narrow_the_posterior_of_measured_joints(write):
    case = write(CASE).model_copy(update={"measured": (object(),)})
    assert all("sampling" not in knob.terms and not knob.draws for knob in cell_knobs(case))


@dataclass(frozen=True)
class _Table:
    steps: int | None = 8
    parts: tuple[int, ...] = (4, 6)
    tolerance: float = 1e-8
    inner: "_Table | None" = field(default=None)

    def model_copy(self, update):
        return type(self)(**{**vars(self), **update})


def test_keys_are_scaled_where_they_are_whole():
    table = _Table(inner=_Table(steps=None))
    change = scaled({"steps": 2, "parts": 0.5, "inner.tolerance": 0.1, "inner.steps": 2})
    new = change(table, 1)
    assert (new.steps, new.parts, new.inner.tolerance, new.inner.steps) == (16, (2, 3), 1e-9, None)
    with pytest.raises(CaseError, match=r"parts = 6 has no whole multiple by 0\.25"):
        change(table, 2)


def test_bodies_name_their_knobs():
    case = load_case("bolted_lap")
    named = {knob.name: knob for knob in body_knobs(case) if knob.applies(case)}
    assert {*named} == {"elements", "layers of the elements", "load steps", "slabs"}
    assert named["elements"].change(case, 1).structure.element == 0.5 * case.structure.element
    assert named["load steps"].change(case, -1).cycles.steps == 4
    assert [name for name, knob in named.items() if knob.terms == (MACRO,)] == ["elements"]
    beam = load_case("brake_reuss")  # on meshes from files, with their error in the budget
    replaced = [knob.terms for knob in body_knobs(beam) if knob.applies(beam)]
    assert set(replaced) == {()}


def test_an_answer_is_read_at_its_pressure_with_its_terms(run_folder):
    from multiscale.pipeline.stages.accuracy import Asked
    from multiscale.pipeline.stages.joint import JOINT
    from multiscale.pipeline.stages.loaded_bodies import LOADED_BODIES

    asked = Asked(JOINT, "joint_stiffness")
    result = open_run(run_folder)["macro_result"].to_dataset()
    datasets = {JOINT.name: result}
    value, _ = asked.values(datasets)
    np.testing.assert_array_equal(value, result["joint_stiffness"])
    preloads = result["preload"].to_numpy()
    np.testing.assert_array_equal(asked.pressures(datasets), preloads)
    at = asked.is_at(preloads, 1.001 * preloads[1])
    np.testing.assert_array_equal(at, preloads == preloads[1])
    with pytest.raises(CaseError, match=r"stiffness is computed at .* MPa; give one of these"):
        asked.is_at(preloads, 1.1 * preloads[1])
    with pytest.raises(CaseError, match="depends on no pressure"):
        asked.is_at(None, preloads[1])
    half = np.linspace(0.01, 0.05, preloads.size)  # of every term
    along = xr.DataArray(half, dims="step")
    datasets[JOINT.name] = result.assign(
        error_half_width=xr.zeros_like(result["error_half_width"]) + along,
        error_bias=xr.zeros_like(result["error_bias"]) - 2.0 * along,
    )
    for places in ([1], [*range(preloads.size)]):
        half_widths, biases = asked.errors(datasets, places)
        np.testing.assert_allclose(half_widths["fit"], half[places])
        np.testing.assert_allclose(biases["fit"], -2.0 * half[places])
    assert "few cells" not in half_widths
    # answers of some steps have the errors of these steps: the others follow in shear
    shear = xr.DataArray(1.0 * (np.arange(preloads.size) > 1), dims="step")
    bodies = datasets[JOINT.name].assign(shear=shear).assign_attrs(path="joint")
    sheared = {LOADED_BODIES.name: bodies}
    half_widths, _ = Asked(LOADED_BODIES, "joint_stiffness").errors(sheared, [0, 1])
    np.testing.assert_allclose(half_widths["fit"], half[:2])
    other = Asked(JOINT, "mean_gap")  # which has no budget
    assert other.errors(datasets, [1]) == ({}, {})
    gap = result["mean_gap"]
    band = xr.concat([0.9 * gap, 1.1 * gap], "limit")
    datasets[JOINT.name] = result.assign(mean_gap_mean_law=band)
    np.testing.assert_allclose(other.errors(datasets, [1])[0]["sampling"], 0.1)


def test_an_error_that_is_not_measured_again_is_at_the_places_of_the_new_answer():
    three = np.array([0.1, 0.2, 0.3])
    error = KnobError(three, 2.0 * three, three, 1.0, three, 0).on(np.zeros(5))
    np.testing.assert_allclose(error.bias, np.linspace(0.2, 0.6, 5))
    assert error.size == pytest.approx(0.9)


@pytest.mark.slow
def test_a_run_with_a_target_reaches_it_and_goes_on_where_it_was(write, tmp_path, caplog):
    caplog.set_level("INFO", "multiscale")
    case = write(CASE.replace('"12 %"', '"7 %"'))
    results = run(case, tmp_path / "out")
    assert "round 1: " in caplog.text
    plan = results["accuracy"]
    assert float(plan["error"].max()) <= 0.07
    assert plan.attrs["answer"] == "mean_gap"
    gap = results.interface_law["fit_mean_gap"]
    np.testing.assert_allclose(gap, plan["solved_value"], rtol=1e-12)
    assert results.macro_result.attrs["seconds"] > 0.0
    assert {"micro_response", "interface_law"} <= set(map(str, plan["stage"].values))
    assert verify_run(tmp_path / "out").startswith("the first realisation computed again agrees")

    # a killed run has its cells and settings, and ends with the same answer
    cells = sorted((tmp_path / "out" / "plan").glob("*/micro/*.nc"))
    before = {file: file.stat().st_mtime_ns for file in cells}
    for file in (tmp_path / "out").glob("*.nc"):
        file.unlink()
    again = run(case, tmp_path / "out")
    np.testing.assert_array_equal(again["accuracy"]["value"], plan["value"])
    assert all(file.stat().st_mtime_ns == before[file] for file in cells)
    assert before.keys() == set((tmp_path / "out" / "plan").glob("*/micro/*.nc"))


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            'quantity = "mean_gap"',
            'of = "damping"',
            r"'damping' in .accuracy. is not an answer .* 'joint_stiff",
        ),
        (
            'quantity = "mean_gap"',
            'of = "conductance"',
            r"may be 'thermal_conductance' .*, 'electrical_conductance' .*; give one",
        ),
        ('quantity = "mean_gap"', 'time = "1 us"', r"time in \[accuracy\] is 1e-06 s, and a cell"),
        ('target = "12 %"\nquantity = "mean_gap"', "", "neither target nor time is given"),
        ('quantity = "mean_gap"', 'quantity = "mean_gap"\nof = "gap"', "two names of the answer"),
    ],
)
def test_targets_that_no_plan_can_have_are_refused(write, tmp_path, old, new, sentence):
    with pytest.raises(CaseError, match=sentence):
        run(write(CASE.replace(old, new)), tmp_path / "out")


@pytest.mark.parametrize(
    ("of", "name"),
    [
        ("gap", "mean_gap"),
        ("joint_stiffness", "joint_stiffness"),
        ("real pressure", "real_pressure"),
    ],
)
def test_an_answer_is_named_by_its_words(write, of, name):
    from multiscale.pipeline.stages import COMPUTED
    from multiscale.pipeline.stages.accuracy import find_answers

    case = write(CASE.replace('quantity = "mean_gap"', f'of = "{of}"'))
    assert find_answers(case, COMPUTED)[0].name == name

"""Every term of the budget recovers the error that was put in, and unknown terms are reported."""

import numpy as np
import pytest
from scipy.stats import t

from multiscale.errors import CaseError
from multiscale.io import open_law, save_law
from multiscale.schema import ERROR_BUDGET, INTERFACE_LAW, MICRO_RESPONSE
from multiscale.upscaling import (
    Bound,
    Correction,
    Knob,
    Samples,
    Uncertainty,
    at_rms_height,
    error_budget,
    fit_law,
    law_from_dataset,
    law_sources,
    propagate,
    with_budget,
    with_scales,
)
from multiscale.upscaling.budget import (
    ALWAYS,
    ERROR_TERMS,
    FEW_CELLS,
    MACRO,
    STATED,
    Term,
    assemble_budget,
    known_terms,
    mean_law_error,
    total_error,
)
from multiscale.upscaling.free_form import decay_share
from multiscale.upscaling.scales import compare_scales, effective_cells
from tests.upscaling.responses import DECAY, PRESSURE, SCALE, response_of

TRUTH = DECAY * np.log(SCALE / PRESSURE)


def ensemble(n=12, *, spread=0.03, factor=1.0, seed=1):
    """Exponential gaps and areas with one factor per realisation, and a common error."""
    random = np.random.default_rng(seed)
    scatter = 1.0 + spread * random.standard_normal((n, 1))
    area = factor * PRESSURE / 5e8 / scatter
    return response_of(factor * TRUTH * scatter, area=area)


def carried(name, law, solve, pressure=None, *further, cells=None, samples=0):
    """Budget of an answer of a structure by the budget of a law and further sources."""
    sources = [*law_sources(law, pressure, samples=samples), *further]
    sources = sources if cells is None else [source.averaged(cells) for source in sources]
    return propagate(name, sources, solve, solve(law_from_dataset(law)))


def half(budget, term, quantity="mean_gap"):
    return budget["error_half_width"].sel(error_term=term, quantity=quantity).values


def test_the_budget_follows_its_schema_and_lists_unknown_terms():
    response = ensemble()
    budget = error_budget(response, fit_law(response), discrepancy=0.0)
    ERROR_BUDGET.check(budget)
    assert list(budget["quantity"].values) == ["mean_gap", "contact_fraction", "stiffness"]
    assert (
        budget.attrs["unknown"] == "cell size, micro discretisation, small slopes, scale separation"
    )
    assert budget.attrs["how_cell_size"].startswith("not known: cells of one size")
    np.testing.assert_allclose(
        budget["error_total"].sel(quantity="mean_gap"),
        np.hypot(half(budget, "sampling"), half(budget, "fit")),
    )


@pytest.mark.parametrize(("n", "student"), [(2, 12.7062), (3, 4.30265), (12, 2.200985)])
@pytest.mark.parametrize("family", ["convex_decreasing", "exponential"])
def test_sampling_is_students_interval_from_two_realisations_on(n, student, family):
    """One factor on all gaps of a realisation is one factor on its decay length, u = p / K."""
    response = ensemble(n)
    budget = error_budget(response, fit_law(response, family=family, n_samples=0))
    gap = response["mean_gap"].values
    expected = student * gap.std(axis=0, ddof=1) / np.sqrt(n) / gap.mean(axis=0)
    np.testing.assert_allclose(half(budget, "sampling"), expected, rtol=1e-5)
    np.testing.assert_allclose(half(budget, "sampling", "stiffness"), expected, rtol=2e-2)
    area = response["contact_fraction"].values
    expected = student * area.std(axis=0, ddof=1) / np.sqrt(n) / area.mean(axis=0)
    np.testing.assert_allclose(half(budget, "sampling", "contact_fraction"), expected, rtol=1e-5)
    assert np.all(np.isfinite(budget["error_total"]))


@pytest.mark.parametrize("n", [4, 12])
def test_a_few_samples_give_the_scatter_of_all(n):
    """Differences of two gaps, as in losses, by cells of which two lengths scatter."""
    random = np.random.default_rng(3)
    bend = np.log(PRESSURE / PRESSURE[-1]) ** 2
    scatter = random.standard_normal((n, 2)) @ [0.02 + 0.0 * bend, 3e-3 * bend]
    response = response_of(TRUTH * (1.0 + scatter))
    law = fit_law(response, n_samples=40)
    law = with_budget(law, error_budget(response, law, discrepancy=0.0))
    p = np.array([2.0 * PRESSURE[0], 6.0 * PRESSURE[0], 0.3 * PRESSURE[-1], PRESSURE[-1]])

    def loss(normal):
        gap = normal.gap_at(p)
        return np.array([gap[0] - gap[1], gap[2] - gap[3], np.nan])

    value = loss(law_from_dataset(law))
    every, few = (
        half(propagate("loss", law_sources(law, **options), loss, value), "sampling", "loss")
        for options in ({"samples": 40}, {"drawn": np.full((40, 1, 3), np.nan)})
    )
    assert few[:2] == pytest.approx(every[:2], rel=0.1)
    assert np.isnan([every[2], few[2]]).all()  # an unknown answer has no error


@pytest.mark.parametrize(("beyond", "at"), [((True, False), 0.3e6), ((False, True), 3e8)])
def test_load_beyond_the_data_has_the_error_of_the_form_of_the_law_there(beyond, at):
    """Of gaps that fall by a power of the pressure, which no law of free form continues."""
    p = 1e6 * 2.0 ** np.arange(8)
    gap = 1e-6 * (p / 1e6) ** -0.2
    stiff = at / 0.2 / (1e-6 * (at / 1e6) ** -0.2)
    law = fit_law(response_of(np.tile(gap, (4, 1)), p, area=np.tile(p / 5e9, (4, 1))), n_samples=0)
    budget = error_budget(response_of(np.tile(gap, (4, 1)), p), law, discrepancy=0.0)
    law = with_budget(law, budget)

    def stiffness(normal):
        return normal.stiffness(normal.gap_at(np.array([at])))

    value = stiffness(law_from_dataset(law))
    halves = [
        half(
            propagate("stiffness", law_sources(law, beyond=ends), stiffness, value),
            "fit",
            "stiffness",
        )
        for ends in ((False, False), beyond)
    ]
    error = abs(value / stiff - 1.0)
    assert halves[0] < error < halves[1] < 10.0 * error


@pytest.mark.parametrize("ends", [(True, False), (False, True)])
def test_the_form_of_a_law_of_three_pressures_is_unknown_beyond_them(ends):
    response = response_of(TRUTH[None, :3] * np.ones((4, 1)), PRESSURE[:3])
    law = fit_law(response, n_samples=0)
    law = with_budget(law, error_budget(response, law, discrepancy=0.0))

    def gaps(normal):
        return normal.gap_at(PRESSURE)

    value = gaps(law_from_dataset(law))
    inside, beyond = (
        propagate("gap", law_sources(law, beyond=where), gaps, value)
        for where in ((False, False), ends)
    )
    assert np.isfinite(inside["error_total"]).all()
    assert np.isnan(beyond["error_total"]).all()
    assert beyond.attrs["how_fit"].endswith("3 pressures, of which none can be left out")


def test_one_realisation_leaves_sampling_and_the_totals_unknown():
    response = ensemble(1)
    law = fit_law(response)
    budget = error_budget(response, law, scales=compare_scales(0.1, 0.5, 1.0))
    assert budget.attrs["unknown"] == "sampling, cell size, micro discretisation, small slopes"
    assert np.isfinite(half(budget, "scale separation")).all()
    assert "solve 3" in budget.attrs["how_sampling"]
    assert np.all(np.isnan(budget["error_total"]))
    carrying = with_scales(with_budget(law, budget), compare_scales(0.2, 0.5, 1.0))
    assert np.all(np.isnan(carrying["error_total"]))
    answer = carried("k", carrying, lambda item: item.stiffness(np.array([1e-6])))
    assert np.isnan(answer["error_total"]).all()


def test_a_term_that_cannot_be_computed_makes_the_total_unknown_and_never_smaller():
    """Of one quantity at one step; terms that nothing was given for stay out of totals."""
    response = ensemble(6)
    law = fit_law(response, n_samples=0)
    coarse = {2.0: ensemble(6, factor=1.02)}
    law = with_budget(law, error_budget(response, law, resolutions=coarse))
    assert "cell size" in law.attrs["unknown"]
    assert np.isfinite(law["error_total"]).all()
    lost = {"quantity": "stiffness", "error_term": "micro discretisation", "step": 3}
    law["error_half_width"].loc[lost] = np.nan
    rescaled = with_scales(law, compare_scales(0.1, 0.5, 1.0))
    known = np.isfinite(rescaled["error_total"].values)
    np.testing.assert_array_equal(np.argwhere(~known), [[2, 3]])

    def solve(item):
        return item.stiffness(item.gap_at(PRESSURE[[1, 3]]))

    answer = carried("k", law, solve, PRESSURE[[1, 3]])
    np.testing.assert_array_equal(np.isnan(answer["error_total"].values[0]), [False, True])


def test_the_stiffness_is_unsure_where_it_bends_at_the_end_of_the_data():
    """An exponential law has K = p / u; a law that ends at complete contact rises beyond bounds."""
    even = response_of(np.tile(TRUTH, (3, 1)))
    half_width = half(error_budget(even, fit_law(even, n_samples=0)), "fit", "stiffness")
    assert np.all(half_width[[0, -1]] < 0.02)
    share = PRESSURE / (1.05 * PRESSURE[-1])
    closing = response_of(np.tile(DECAY * (1.0 - share + share * np.log(share)), (3, 1)))
    law = fit_law(closing, n_samples=0)
    half_width = half(error_budget(closing, law), "fit", "stiffness")
    single_law = law_from_dataset(law)
    exact = PRESSURE / (DECAY * -share * np.log(share))  # -dp/dg
    error = np.abs(single_law.stiffness(single_law.gap_at(PRESSURE)) / exact - 1.0)
    assert error[-1] > 0.1
    assert np.all(error <= half_width + 0.02)


def test_the_decay_of_the_error_over_the_spacing_is_measured_and_no_higher_order_is_believed():
    """Five points: three are left out of all, the middle one of every second."""
    fine = 0.01 * np.array([1.0, -1.0, 1.0])
    for coarse, share in ((0.02, 0.5), (0.03, 1.0 / 3.0), (0.5, 0.25), (0.005, 1.0), (0.0, 1.0)):
        assert decay_share(np.append(fine, coarse), 5, 0.25) == pytest.approx(share)
    assert decay_share(fine[:2], 4, 0.25) == 1.0
    noise = np.array([0.5e-4, 0.5e-4, 0.5e-4, 2e-4])  # half of the squares, and of 4e-4
    share = decay_share(np.append(fine, 0.02), 5, 0.25, noise)
    assert share == pytest.approx(0.5 * np.sqrt(0.5))


def test_the_fit_term_takes_the_shares_of_the_law():
    response = response_of(np.tile(TRUTH + 0.02 * DECAY * np.cos(np.arange(8)), (3, 1)))
    law = fit_law(response, n_samples=0)
    for name, share, quantity in (
        ("fit_error", "gap_fit_share", "mean_gap"),
        ("area_fit_error", "area_fit_share", "contact_fraction"),
        ("stiffness_fit_error", "stiffness_fit_share", "stiffness"),
    ):
        rms = float(np.sqrt(np.nanmean(law[name].values ** 2)))
        for given in (float(law[share]), 0.8):
            half_width = half(
                error_budget(response, law.assign({share: law[share].copy(data=given)})),
                "fit",
                quantity,
            )
            student = t.ppf(0.975, np.isfinite(law[name]).sum())
            assert half_width.min() == pytest.approx(student * given * rms)
    exponential = fit_law(response, family="exponential", n_samples=0)
    assert exponential["gap_fit_share"] == exponential["stiffness_fit_share"] == 1.0


def test_noise_that_the_sampling_counts_is_not_counted_by_the_fit_of_the_area():
    """Areas p / p_0 with a factor for every value: interpolation adds no error."""
    random, apart, text = np.random.default_rng(seed=3), [], []
    for _ in range(10):
        area = PRESSURE / 5e8 * (1.0 + 0.03 * random.standard_normal((6, 8)))
        for item, shares in ((area, apart), (area.mean(axis=0, keepdims=True), text)):
            data = response_of(np.tile(TRUTH, (len(item), 1)), area=item)
            shares.append(float(fit_law(data, n_samples=0)["area_fit_share"]))
    assert np.mean(apart) < 0.5 * np.mean(text)  # one realisation does not show its noise


@pytest.mark.parametrize("full", [1.3, 2.0, 4.0])
@pytest.mark.parametrize("steps", [8, 12])
def test_the_fit_term_of_the_stiffness_at_the_highest_pressure_is_of_the_size_of_the_error(
    full, steps
):
    """Of Westergaard's law up to 1/full of complete contact: two standard deviations, not ten."""
    p = np.geomspace(0.05 * PRESSURE[-1], PRESSURE[-1], steps)
    share = p / (full * p[-1])
    gap = DECAY * (1.0 - share + share * np.log(share))
    closing = response_of(np.tile(gap, (3, 1)), p)
    law = fit_law(closing, n_samples=0)
    single_law = law_from_dataset(law)
    exact = p / (DECAY * -share * np.log(share))
    error = abs(exact[-1] / single_law.stiffness(single_law.gap_at(p))[-1] - 1.0)
    half_width = half(error_budget(closing, law), "fit", "stiffness")[-1]
    assert error <= half_width <= 0.05 + 6.0 * error
    if full >= 2.0:  # holes of four spacings show higher orders than the second, not believed
        assert (law["gap_fit_share"], law["stiffness_fit_share"]) == (0.25, 0.5)


@pytest.mark.slow
def test_the_variance_of_the_differences_of_grids_counts_once():
    """No bias: the rest is the interval of the mean difference."""
    random, computed = np.random.default_rng(seed=5), []
    for _ in range(20):
        fine = 1.0 + 0.01 * random.standard_normal((8, 1))
        pair = [response_of(TRUTH * item) for item in (np.ones((8, 1)), fine)]
        budget = error_budget(pair[0], fit_law(pair[0], n_samples=0), resolutions={2.0: pair[1]})
        spread = 2.3646 * fine.std(ddof=1) / np.sqrt(8)
        computed.append(half(budget, "micro discretisation")[0] / spread)
    assert np.median(computed) < 1.15


@pytest.mark.parametrize("order", [1.0, 2.0])
def test_the_discretisation_term_is_the_error_of_the_grid(order):
    """2 % of error on the grid of the response."""
    coarse = {r: ensemble(factor=1.0 + 0.02 * r**order) for r in (2.0, 4.0)}
    response = ensemble(factor=1.02)
    budget = error_budget(response, fit_law(response), resolutions=coarse)
    for quantity in ("mean_gap", "contact_fraction"):
        computed = half(budget, "micro discretisation", quantity) * 1.02 / 0.02
        assert np.all((computed > 1.25) & (computed < 1.5)), computed
    assert f"observed order {order:.2g}" in budget.attrs["how_micro_discretisation"]


def test_grids_of_other_cells_give_the_error_at_the_spacing_of_the_response():
    """An error of first order, 2 % on the response: half of it solved, and half of it left.

    Grids half and twice as fine; the finest grid has few of the cells.
    """
    counts = {0.5: 5, 1.0: 12, 2.0: 12}
    grids = {r: ensemble(factor=1.0 + 0.02 * r, seed=9) for r in counts}
    grids = {r: value.isel(realisation=slice(counts[r])) for r, value in grids.items()}
    response = ensemble(factor=1.02)
    budget = error_budget(response, fit_law(response), resolutions=grids)
    for quantity in ("mean_gap", "contact_fraction"):
        computed = half(budget, "micro discretisation", quantity) / (0.01 / 1.01)
        assert np.all((computed > 1.24) & (computed < 1.6)), computed
        bias = budget["error_bias"].sel(error_term="micro discretisation", quantity=quantity)
        np.testing.assert_allclose(bias, 0.01 / 1.01, rtol=0.05)
    few = {0.5: grids[1.0], 1.0: grids[0.5]}
    with pytest.raises(CaseError, match="at the ratio 1 has 5 realisations, not 12; solve the"):
        error_budget(response, fit_law(response), resolutions=few)


def test_what_increments_leave_enters_every_total():
    response, n = ensemble(factor=1.02), PRESSURE.size
    names = ("mean_gap_increment_error", "contact_fraction_increment_error")
    errors = dict(zip(names, (0.04 * np.ones(n), 0.01 * np.ones(n)), strict=True))
    share = {"flowing_fraction": np.full(response["mean_gap"].shape, 0.1)}
    law = fit_law(response, n_samples=0)
    rigid = error_budget(response, law)
    budget = error_budget(MICRO_RESPONSE.assign(response, errors | share), law)
    for quantity, error in (("mean_gap", 0.04), ("contact_fraction", 0.01)):
        np.testing.assert_allclose(half(budget, "increments", quantity), 1.25 * error)
        before, after = (item["error_total"].sel(quantity=quantity) for item in (rigid, budget))
        np.testing.assert_allclose(after, np.hypot(before, 1.25 * error))
    assert "up to 5 %, 1.2 %, 4.8 % of gap" in budget.attrs["how_increments"]
    assert not half(rigid, "increments").any()
    # cells that flow, and that nobody solved with halved increments
    blind = error_budget(MICRO_RESPONSE.assign(response, share), law)
    assert "increments" in blind.attrs["unknown"]
    assert blind["error_total"].isnull().all()


def test_slopes_that_are_taken_as_small_enter_totals_where_they_were_stated():
    response, n = ensemble(factor=1.02), PRESSURE.size
    errors = {
        "mean_gap_slope_error": -0.03 * np.ones(n),
        "contact_fraction_slope_error": np.zeros(n),
    }
    law = fit_law(response, n_samples=0)
    changed = MICRO_RESPONSE.assign(response, errors).assign_attrs(small_slopes="expanded in one")
    blind, computed = (error_budget(answer, law) for answer in (response, changed))
    np.testing.assert_allclose(half(computed, "small slopes", "mean_gap"), 1.25 * 0.03)
    before, after = (item["error_total"].sel(quantity="mean_gap") for item in (blind, computed))
    np.testing.assert_allclose(after, np.hypot(before, 1.25 * 0.03))
    assert "expanded in one: up to 3.8 %, 0 %, 3.9 % of gap" in computed.attrs["how_small_slopes"]
    assert "small slopes" in blind.attrs["unknown"]


def test_gaps_are_taken_to_the_height_of_the_surface_at_large():
    """Gaps in proportion to separate heights, which are 10 % too large on average."""
    random = np.random.default_rng(seed=6)
    height = 1e-6 * (1.1 + 0.1 * random.standard_normal(6))
    response = response_of(TRUTH * height[:, None] / 1e-6)
    with pytest.raises(CaseError, match="has no rms_height of its realisations; add it"):
        at_rms_height(response, 1e-6)
    response = MICRO_RESPONSE.assign(response, {"rms_height": height})
    np.testing.assert_allclose(
        at_rms_height(response, 1e-6)["mean_gap"], np.tile(TRUTH, (6, 1)), rtol=1e-12
    )
    assert at_rms_height(response, 1e-6).attrs["gaps_at_rms_height"] == 1e-6
    with pytest.raises(CaseError, match="rms_height must be positive and finite"):
        at_rms_height(response, 0.0)


def test_the_total_of_a_bias_and_a_spread_is_right_in_95_of_100():
    random = np.random.default_rng(seed=4).standard_normal(200_000)
    for bias in (0.0, 0.3, 1.0, 3.0, 8.0):
        bound = float(total_error(np.array(bias), np.array(1.96)))
        assert np.mean(np.abs(bias + random) <= bound) == pytest.approx(0.95, abs=2e-3)
    assert float(total_error(np.array(-2.0), np.array(0.0))) == 2.0


def test_the_scale_term_has_both_its_parts():
    """Half a cell on the length of the structure: CoV / 2; uneven pressure: u_0 eps^2 / 24."""
    response = ensemble(30, spread=0.05)
    law = fit_law(response)
    budget = error_budget(response, law, scales=compare_scales(0.1, 0.5, 1.0))
    gap = response["mean_gap"].values
    few = 1.96 * 0.5 * gap.std(axis=0, ddof=1) / gap.mean(axis=0)
    np.testing.assert_allclose(half(budget, "few cells"), few, rtol=1e-4)
    even = response_of(np.tile(TRUTH, (3, 1)))
    budget = error_budget(even, fit_law(even), scales=compare_scales(0.5, 1e-9, 1.0))
    np.testing.assert_allclose(
        half(budget, "scale separation")[1:-1], (DECAY * 0.25 / 24.0 / TRUTH)[1:-1], rtol=0.05
    )


def test_a_part_has_the_discrepancy_of_joints_from_cells_and_the_mean_law_has_not():
    """Of an exponential law: level and exponent of the stiffness, and the gap below its top."""
    response = ensemble(10)
    law, w = fit_law(response), 0.2
    budget, without = (error_budget(response, law, discrepancy=share) for share in (w, 0.0))
    x = np.log(PRESSURE / np.sqrt(PRESSURE[0] * PRESSURE[-1]))
    part = half(budget, "model discrepancy", "stiffness")
    np.testing.assert_allclose(part, w * np.hypot(1.0, 0.5 * x), rtol=1e-3)
    gap, level = law["fit_mean_gap"].values, x[-1] - x
    exponent = 0.25 * (x[-1] ** 2 - x**2)
    expected = w * np.hypot(level, exponent) * (gap[0] - gap[-1]) / level[0] / gap
    np.testing.assert_allclose(half(budget, "model discrepancy"), expected, rtol=1e-2, atol=1e-6)
    np.testing.assert_allclose(mean_law_error(budget), mean_law_error(without))
    total = budget["error_total"].sel(quantity="stiffness")
    np.testing.assert_allclose(
        total, np.hypot(without["error_total"].sel(quantity="stiffness"), part)
    )
    assert np.all(np.isnan(half(without, "model discrepancy", "stiffness")))
    usual = error_budget(response, law)
    np.testing.assert_allclose(half(usual, "model discrepancy", "stiffness"), part / 2.0)
    old = with_budget(law, without).drop_sel(error_term="model discrepancy")
    del old.attrs["how_model_discrepancy"]
    assert "model discrepancy" not in known_terms(old)
    read = with_scales(old, compare_scales(0.1, 0.5, 1.0))
    np.testing.assert_allclose(
        mean_law_error(read)[:, 1:-1],
        mean_law_error(with_scales(with_budget(law, without), compare_scales(0.1, 0.5, 1.0)))[
            :, 1:-1
        ],
    )


def test_the_mean_part_is_surer_than_one_part_by_its_few_cells():
    response = ensemble(10)
    law = fit_law(response)
    alone = error_budget(response, law, discrepancy=0.0)
    np.testing.assert_allclose(mean_law_error(alone), alone["error_total"], rtol=1e-12)
    scales = compare_scales(1e-6, 0.5, 1.0)
    budget = error_budget(response, law, scales=scales, discrepancy=0.0)
    np.testing.assert_allclose(mean_law_error(budget), alone["error_total"], rtol=1e-6)
    few = budget["error_half_width"].sel(error_term="few cells")
    both = np.hypot(alone["error_total"], few)
    np.testing.assert_allclose(budget["error_total"], both, rtol=1e-6)


def test_an_interface_averages_over_the_cells_that_carry_its_weight():
    """Half of an even weight leaves half of the cells; points may be of any size."""
    area = np.array([1.0, 3.0, 2.0, 2.0])
    weight = np.array([[1.0, 1.0, 1.0, 1.0], [2.0, 2.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]])
    result = effective_cells(weight, area, 0.5)
    np.testing.assert_allclose(result, [32.0, 16.0, np.nan])


def test_further_parameters_and_other_numbers_of_cells_enter_the_budget_of_a_structure():
    response = ensemble(20)
    law = fit_law(response, family="exponential")
    law = with_budget(law, error_budget(response, law, scales=compare_scales(0.1, 0.5, 1.0)))
    p = np.array([1e7, 5e7])

    def solve(item):
        return item.stiffness(item.gap_at(p))

    plain = carried("k", law, solve)
    ratio = Uncertainty(
        name="r", half_width={"sampling": 0.04, "fit": np.nan}, rate=np.array([[0.5, 0.0]])
    )
    load = carried("k", law, solve, None, ratio, cells=np.array([[4.0, 1]]))
    np.testing.assert_allclose(half(load, "few cells", "k"), half(plain, "few cells", "k") / [2, 1])
    added = np.hypot(half(plain, "sampling", "k"), [0.02, 0.0])
    np.testing.assert_allclose(half(load, "sampling", "k"), added)
    np.testing.assert_array_equal(np.isnan(half(load, "fit", "k")), [True, False])
    np.testing.assert_array_equal(np.isnan(load["error_total"][0]), [True, False])


def test_a_law_carries_its_budget_through_its_file(tmp_path):
    response = ensemble()
    law = fit_law(response, n_samples=20)
    carrying = with_budget(law, error_budget(response, law))
    INTERFACE_LAW.check(carrying)
    save_law(carrying, tmp_path / "law.nc")
    read = open_law(tmp_path / "law.nc")
    np.testing.assert_array_equal(read["error_total"], carrying["error_total"])
    assert list(read["error_term"].values)[:2] == ["sampling", "fit"]
    assert read.attrs["how_fit"] == carrying.attrs["how_fit"]


def test_the_budget_of_a_structure_propagates_the_budget_of_the_law():
    """A spring in series: 1/K = 1/K_law + 1/K_0, and K_law is inverse to a factor of the gap."""
    response = ensemble(20, factor=1.02)
    law = fit_law(response, family="exponential")
    coarse = {2.0: ensemble(20, factor=1.04), 4.0: ensemble(20, factor=1.08)}
    carrying = with_budget(law, error_budget(response, law, resolutions=coarse))
    solid, p = 1e14, np.array([1e7, 5e7])

    def solve(item):
        return 1.0 / (1.0 / item.stiffness(item.gap_at(p)) + 1.0 / solid)

    answer = solve(law_from_dataset(law))
    mesh = Knob(name="elements", ratios=(2.0, 4.0), answers=[answer * 1.04, answer * 1.2])
    budget = carried("joint_stiffness", carrying, solve, None, mesh, samples=100)
    ERROR_BUDGET.check(budget)
    share = answer / (p / float(law["decay_length"]))  # of the interface in the compliance
    item = {
        str(term): half(budget, term, "joint_stiffness") for term in budget["error_term"].values
    }
    grid = carrying["error_half_width"].sel(error_term="micro discretisation")
    of_law = np.sqrt(np.mean(grid.sel(quantity=["mean_gap", "stiffness"]) ** 2, axis=1)).max()
    np.testing.assert_allclose(item["micro discretisation"], float(of_law) * share, rtol=0.05)
    np.testing.assert_allclose(item["macro discretisation"], 1.25 * 0.04 / 3.0, rtol=0.1)
    sampling = half(carrying, "sampling", "stiffness").mean()
    np.testing.assert_allclose(item["sampling"], sampling * share, rtol=0.3)
    assert np.all(np.isnan(item["cell size"]))
    assert budget.attrs["unknown"] == "cell size, small slopes, scale separation"


def test_a_term_of_which_the_law_contains_half_is_unknown_in_the_structure():
    response = ensemble(20)
    law = fit_law(response, family="exponential")
    law, p = with_budget(law, error_budget(response, law)), np.array([1e7, 5e7])
    law["error_half_width"].loc[{"quantity": "stiffness", "error_term": "sampling"}] = np.nan
    budget = carried("k", law, lambda item: item.stiffness(item.gap_at(p)))
    assert np.isnan(half(budget, "sampling", "k")).all()
    assert "sampling" in budget.attrs["unknown"]


def test_several_answers_have_the_budget_of_each_answer():
    response = ensemble(20)
    law = fit_law(response, family="exponential")
    law, p = with_budget(law, error_budget(response, law)), np.array([1e7, 5e7])

    def stiffness(item):
        return item.stiffness(item.gap_at(p))

    def series(item):
        return 1.0 / (1.0 / stiffness(item) + 1e-14)

    solves = {"joint_stiffness": series, "interface_stiffness": stiffness}

    def both(item):
        return np.stack([solve(item) for solve in solves.values()])

    def mesh(solve):
        return Knob(name="mesh", ratios=(2.0,), answers=[1.01 * solve(law_from_dataset(law))])

    together = carried(tuple(solves), law, both, None, mesh(both))
    ERROR_BUDGET.check(together)
    for name, solve in solves.items():
        alone = carried(name, law, solve, None, mesh(solve))
        for variable in ("error_half_width", "error_total"):
            row = together[variable].sel(quantity=name)
            np.testing.assert_allclose(row, alone[variable][0], rtol=1e-12)
    # the part from the law is not shared by the bodies
    total = together["error_total"].values
    assert np.all(total[1] > total[0])


def test_every_kind_of_source_adds_its_known_error():
    """An answer a b, with half-widths of 10 % and 5 %; signs of biases stay, unknown terms too."""
    value = np.array([[6.0, 12.0]])

    def solve(change):
        return value * change

    sources = [
        Uncertainty(
            name="a", of="one", half_width={STATED: 0.1}, how={STATED: "10 %"}, changes=[1.02]
        ),
        Uncertainty(name="b", of="two", half_width={STATED: 0.05}, rate=-np.ones((1, 2))),
        Correction(name="bias", changes=[0.97], term="cell size"),
        Knob(name="points", ratios=(2.0,), changes=[0.96]),
        Knob(name="steps", changes=[1.3], share=np.array([[0.0, 0.1]])),
        Samples(
            name="draws", answers=[value * (1.0 + x) for x in np.linspace(-1.0, 1.0, 41)], how="41"
        ),
        Bound(name="cells", of="two", bounds={STATED: Term("counted", np.array([0.0, 0.2]))}),
        Bound(name="unknown", bounds={"small slopes": Term("not known: solve one")}),
    ]
    done = []
    intervals = propagate("ab", sources, solve, base=1.0, progress=lambda *one: done.append(one))
    assert done[-1] == (5, 5)
    np.testing.assert_allclose(
        half(intervals, STATED, "ab"), np.hypot(np.hypot(0.1, 0.05), [0.0, 0.2])
    )
    assert intervals.attrs["how_stated_values"] == "one: 10 %; two: counted"
    np.testing.assert_allclose(half(intervals, MACRO, "ab"), [0.05, np.hypot(0.05, 0.03)])
    np.testing.assert_allclose(half(intervals, "sampling", "ab"), 0.95)
    np.testing.assert_allclose(intervals["error_bias"].sel(error_term="cell size"), [[0.03, 0.03]])
    np.testing.assert_allclose(intervals["sensitivity"][:, 0], [[0.1, 0.1], [-0.05, -0.05]])
    assert intervals["parameter"].values.tolist() == ["one: a", "two: b"]
    assert intervals.attrs["unknown"] == "small slopes"
    assert np.isfinite(intervals["error_total"]).all()
    lacking = Bound(name="law", bounds={"sampling": Term("not known: one realisation")})
    intervals = propagate("ab", [*sources, lacking], solve, value)
    assert np.isnan(intervals["error_total"]).all()
    with pytest.raises(TypeError, match="5 answers are unknown, and solve is missing"):
        propagate("ab", sources)


def test_samples_that_change_an_answer_by_more_than_first_order_holds_are_unknown():
    weights = np.linspace(-1.0, 1.0, 41)[:, None]
    samples = Samples(name="few", changes=[None], how="few", weights=weights)
    (term,) = samples.terms(np.ones((1, 2)), [np.array([[1.3, 1.9]])]).values()
    np.testing.assert_allclose(term.half_width, [[0.95 * 0.3, np.nan]])


def test_a_budget_of_an_earlier_version_is_refused_in_a_sentence():
    response = ensemble()
    law = fit_law(response, n_samples=0)
    law = with_budget(law, error_budget(response, law))
    old = law.drop_attrs(deep=False).sel(error_term=law["error_term"] != "surface")
    old = old.assign_attrs({k: v for k, v in law.attrs.items() if k != "how_surface"})
    with pytest.raises(CaseError, match=r"needs how_surface, .* of an earlier version"):
        with_scales(old, compare_scales(1e-5, 1e-4, 1e-2, extent=1e-2))


def test_biases_add_with_their_signs_and_the_mean_law_is_without_the_few_cells_of_one_part():
    none = np.zeros((1, 1))
    terms = {name: Term("", none if name in ALWAYS else None) for name in ERROR_TERMS}
    terms["fit"] = Term("", none, bias=0.03)
    terms["cell size"] = Term("", none, bias=-0.01)
    terms[FEW_CELLS] = Term("", none, bias=0.02)
    budget = assemble_budget(terms, ("gap",), np.array([1e6]))
    assert float(budget["error_total"].squeeze()) == pytest.approx(0.04)
    assert mean_law_error(budget).item() == pytest.approx(0.02)

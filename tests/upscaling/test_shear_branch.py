"""The tangential branch of a law: recovery, samples, messages and refusals."""

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure

from multiscale.errors import CaseError
from multiscale.io import open_law, save_law
from multiscale.laws import Exponential, Sliders
from multiscale.laws.bulk import Elastic
from multiscale.micro import Cell, Path, SecondBody, Surface, run_ensemble, shear_path
from multiscale.plotting import plot_shear_law
from multiscale.schema import INTERFACE_LAW, MICRO_RESPONSE, branch_of
from multiscale.upscaling import (
    assume_shear,
    error_budget,
    fit_branches,
    fit_law,
    law_from_dataset,
    law_sources,
    propagate,
    sliders_from_dataset,
    with_budget,
    with_scales,
)
from multiscale.upscaling.branches import sliding_friction_at, with_sliding
from multiscale.upscaling.scales import compare_scales
from multiscale.upscaling.shear_fit import (
    LossRatio,
    bed_loss,
    bed_traction,
    between_pressures,
    with_shear,
)
from tests.support import rough_square
from tests.upscaling.responses import DECAY, SCALE, response_of, sheared_exponentials, slid

KAPPA, MU, CELLS = 0.8, 0.25, 6
WIDE = np.geomspace(1e5, 1e8, 13)


def scatter(spread, seed):
    return 1.0 + spread * np.random.default_rng(seed).standard_normal(CELLS)


def pressed(decay):
    """Cells of exponential laws, pressed."""
    gap = decay[:, None] * np.log(SCALE / WIDE)
    return response_of(gap, WIDE, area=np.tile(WIDE / 5e8, (len(gap), 1)))


def sheared(decay, ratio=None, friction=None, **options):
    ratio = np.full((CELLS, 2), KAPPA) if ratio is None else ratio
    return sheared_exponentials(
        decay, ratio, np.full(CELLS, MU) if friction is None else friction, **options
    )


@pytest.fixture(scope="module")
def decay():
    return DECAY * scatter(0.05, 1)


@pytest.fixture(scope="module")
def law(decay):
    return fit_law(pressed(decay), n_samples=60)


@pytest.fixture(scope="module")
def measured(law, decay):
    ratio = KAPPA * np.stack([scatter(0.02, 2), scatter(0.02, 3)], axis=1)
    return with_shear(law, pressed(decay), sheared(decay, ratio, MU * scatter(0.01, 4))), ratio


def test_ratio_and_friction_are_recovered_though_the_cells_differ_in_stiffness(law, decay):
    entry = with_shear(law, pressed(decay), sheared(decay))
    INTERFACE_LAW.check(entry)
    assert "shear_loss_ratio" not in entry
    np.testing.assert_allclose(entry["shear_stiffness_ratio"], KAPPA, rtol=0.01)
    assert float(entry["shear_friction"]) == pytest.approx(MU, rel=1e-3)
    # cells that are alike but for their decay lengths leave no scatter
    assert np.ptp(entry["shear_stiffness_ratio_sample"].values) < 0.01 * KAPPA
    apart = entry["shear_traction"] - entry["shear_bed_traction"]
    assert np.abs(apart / (MU * entry["shear_pressure"])).max() < 0.01
    assert entry.attrs["branches"].endswith("shear: measured")


def test_x_and_y_are_averaged_or_fitted_apart(measured, law, decay):
    computed, ratio = measured
    np.testing.assert_allclose(computed["shear_stiffness_ratio"], ratio.mean(), rtol=0.01)
    lay = np.column_stack([np.full(CELLS, 0.9), scatter(0.005, 6) * 0.7])
    data = sheared(decay, lay)
    together = with_shear(law, pressed(decay), data, apart=False)
    assert "x and y, 0.9 and 0.702, differ" in together.attrs["cautions"]
    assert "fit them apart" in together.attrs["cautions"]
    split = with_shear(law, pressed(decay), data, apart=True)
    np.testing.assert_allclose(split["shear_stiffness_ratio"], lay.mean(axis=0), rtol=0.01)
    assert "apart" not in split.attrs["cautions"]
    computed = with_shear(law, pressed(decay), data)  # as they differ by more than chance
    np.testing.assert_array_equal(computed["shear_stiffness_ratio"], split["shear_stiffness_ratio"])
    assert sliders_from_dataset(split, along=1).stiffness_ratio == pytest.approx(0.7, rel=0.01)
    assert sliders_from_dataset(split).stiffness_ratio == pytest.approx(0.8, rel=0.01)
    entry = with_shear(law, pressed(decay), sheared(decay, along=(0,)), apart=True)
    assert np.isnan(entry["shear_stiffness_ratio"][1])


def test_cells_that_were_pressed_before_give_their_normal_laws(law, decay):
    """On a coarser grid the cells are a fifth too soft, in pressing and in shear alike."""
    soft = 1.2 * decay
    shear, first = sheared(soft), pressed(soft)
    first = MICRO_RESPONSE.assign(first, {"slip_fraction": 0.0 * first["mean_gap"].values})
    step = np.arange(first.sizes["step"] + shear.sizes["step"])
    whole = xr.concat([first, shear], "step").assign_coords(step=step)
    whole = MICRO_RESPONSE.assign(
        whole, {"branch": branch_of(np.maximum(whole["nominal_pressure"].values, 0.0))}
    )
    entry = with_shear(law, pressed(decay), whole)
    np.testing.assert_allclose(entry["shear_stiffness_ratio"], KAPPA, rtol=0.01)
    alone = with_shear(law, pressed(decay), shear)
    np.testing.assert_allclose(alone["shear_stiffness_ratio"], KAPPA / 1.2, rtol=0.02)


def test_samples_pair_with_samples_of_the_normal_law(law, decay):
    """Friction in proportion to the decay length: so are the samples of the mean."""
    entry = with_shear(law, pressed(decay), sheared(decay, friction=MU * decay / DECAY))
    gaps = [float(law_from_dataset(law, k).gap_at(np.array(1e7))) for k in range(60)]
    assert np.corrcoef(gaps, entry["shear_friction_sample"])[0, 1] > 0.999
    bed = sliders_from_dataset(entry, 3)
    assert bed.friction == float(entry["shear_friction_sample"][3])
    assert bed.normal.gap_at(np.array(1e7)) == gaps[3]


def test_fewer_cells_may_be_sheared_than_are_pressed(law, decay):
    few = sheared(decay).isel(realisation=[1, 2, 4])
    entry = with_shear(law, pressed(decay), few)
    assert entry.attrs["n_sheared"] == 3
    np.testing.assert_allclose(entry["shear_stiffness_ratio"], KAPPA, rtol=0.01)
    assert entry.sizes["shear_sample"] == 60


def test_the_law_in_a_file_makes_the_sliders_and_an_old_file_is_still_read(measured, law, tmp_path):
    computed, _ = measured
    save_law(computed, tmp_path / "law.nc")
    bed, again = sliders_from_dataset(computed), sliders_from_dataset(open_law(tmp_path / "law.nc"))
    assert isinstance(bed, Sliders)
    assert (again.friction, again.stiffness_ratio) == (bed.friction, bed.stiffness_ratio)
    save_law(law, tmp_path / "normal.nc")  # as of an earlier version, without a branch of shear
    with pytest.raises(CaseError, match="no tangential branch; shear cells"):
        sliders_from_dataset(open_law(tmp_path / "normal.nc"))


def test_assumed_values_are_reported(law):
    sheared = assume_shear(law, friction=0.2, stiffness_ratio=0.82)
    assert "shear: assumed, stiffness ratio 0.82 and friction 0.2" in sheared.attrs["branches"]
    assert "the friction coefficient of 0.2 are assumed" in sheared.attrs["cautions"]
    bed = sliders_from_dataset(sheared, 5)
    assert (bed.friction, bed.stiffness_ratio) == (0.2, 0.82)
    assert bed.normal.gap_at(np.array(1e7)) == law_from_dataset(law, 5).gap_at(np.array(1e7))


def test_the_bed_of_any_ratio_and_friction_is_the_unit_bed_with_another_slip(law):
    """Eq. (1), also where the pressure changes and the path turns."""
    rng, normal = np.random.default_rng(3), law_from_dataset(law)
    pressure = np.append(10.0 ** rng.uniform(6.0, 8.0, 40), [0.0, 1e7, 1e7])
    gap = normal.gap_at(np.maximum(pressure, 1e-2))
    slip = np.cumsum(rng.normal(size=(43, 2)), axis=0) * MU * DECAY
    slip[-2] = slip[-3]  # pressed again without shear
    ones = Sliders(normal, 1.0, 1.0, pressures=(1e6, 1e8), slabs=24)
    bed = Sliders(normal, MU, KAPPA, pressures=(1e6, 1e8), slabs=24)
    computed = MU * bed_traction(ones, gap, slip * KAPPA / MU)
    np.testing.assert_allclose(bed_traction(bed, gap, slip), computed, atol=1e-9 * computed.max())
    assert np.abs(computed[-3]).max() < 1e-6 * np.abs(computed).max()  # released
    fresh = MU * bed_traction(ones, gap[-2:], (slip[-2:] - slip[-2]) * KAPPA / MU)
    np.testing.assert_allclose(computed[-2:], fresh, atol=1e-6 * np.abs(computed).max())


def test_friction_and_stiffness_ratio_are_printed_with_their_bands(measured):
    from multiscale.upscaling.branches import describe_shear

    law, _ = measured
    text = describe_shear(law)
    drawn = np.percentile(law["shear_friction_sample"], (2.5, 97.5))
    friction = next(line for line in text if "friction" in line)
    assert f"{float(law['shear_friction']):.3g}" in friction
    assert f"({drawn[0]:.3g} ... {drawn[1]:.3g}, 95 %)" in friction
    assert len(text) == 2


def test_sheared_cells_are_drawn_with_the_bed(measured):
    computed, _ = measured
    ax = Figure().subplots()
    plot_shear_law(computed, ax=ax)
    assert len(ax.lines) == 8  # cells and bed at two pressures along x and y
    cells, bed = (line.get_ydata() for line in ax.lines[:2])
    np.testing.assert_allclose(cells, bed, atol=0.03)
    assert 0.95 < cells[-1] < 1.05


def test_large_sliding_gives_friction_over_pressure(law):
    sliding = with_sliding(law, slid([0.25, 0.2]))
    assert sliding.attrs["branches"].endswith("sliding: measured")
    at = sliding_friction_at(sliding, np.array([1e-9, 0.004, np.sqrt(0.008 * 0.004), 0.008, 1.0]))
    np.testing.assert_allclose(at, [0.2, 0.2, 0.225, 0.25, 0.25])
    known = sliding_friction_at(with_sliding(law, slid([np.nan, 0.2])), np.array([0.008]))
    np.testing.assert_allclose(known, 0.2)
    with pytest.raises(CaseError, match="slid over less than one period at every pressure"):
        with_sliding(law, slid([np.nan, np.nan]))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            lambda r: r.assign_coords(realisation=r.realisation + 3),
            r"realisations \[6, 7, 8\] were",
        ),
        (lambda r: r.isel(step=slice(0, 8)), r"at most 50 % of the contact slips .* slide farther"),
        (lambda r: r.drop_vars("slip_fraction"), "has no slip_fraction; shear cells with friction"),
        (lambda r: r.assign(converged=0 * r.converged), "no sheared realisation converged"),
        (
            lambda r: r.assign(displacement_jump=1e-3 * r.displacement_jump),
            "no bed with a tangential over normal stiffness from 0.1 to 3",
        ),
    ],
)
def test_data_without_a_bed_are_refused(law, decay, change, sentence):
    with pytest.raises(CaseError, match=sentence):
        with_shear(law, pressed(decay), change(sheared(decay)))


def test_a_shear_outside_the_pressures_of_the_law_is_refused(law, decay):
    for pressures in ((2e5, 1e7), (1e7, 2e8)):
        with pytest.raises(CaseError, match=r"sheared from .* shear between 3 times the lowest"):
            with_shear(law, pressed(decay), sheared(decay, pressures=pressures))


def test_a_path_that_ended_early_leaves_its_realisation_out(law, decay):
    broken = sheared(decay)
    broken["converged"].values[2, -3:] = 0
    entry = with_shear(law, pressed(decay), broken)
    assert entry.attrs["n_sheared"] == CELLS - 1
    assert "1 of 6 sheared realisations did not reach the end" in entry.attrs["cautions"]


def two_bodies(points, seed, friction=0.3, opposite=1.0):
    """Two rough bodies of one period of 1 mm; moduli 1 GPa and ``opposite`` GPa, nu = .3."""
    direct, other = (
        rough_square(points, 5e-4, 1e-3 / 4, 0.05 / 2**0.5, seed=item, size=1e-3)
        for item in (seed, 100 + seed)
    )
    return Cell(
        direct, 1e-3, 6, 1e9, 0.3, Surface(-other.heights, other.size),
        friction_coefficient=friction, opposite=SecondBody(1e-3, 6, Elastic(opposite * 1e9, 0.3)),
    )  # fmt: skip


E_STAR = 0.5e9 / (1.0 - 0.3**2)


@pytest.mark.slow
def test_cells_of_two_bodies_are_pressed_sheared_released_and_pressed_again(tmp_path):
    cells = [two_bodies(12, 0)]
    pressures = 0.05 * E_STAR * np.array([0.05, 0.1])
    path = shear_path(cells[0], list(pressures), along="x", steps=5)
    response = run_ensemble(cells, path, folder=tmp_path, identity="sheared")
    again = run_ensemble(cells, path, folder=tmp_path, identity="sheared")
    assert response.drop_vars("wall_time").equals(again.drop_vars("wall_time"))
    assert response["converged"].values.all()
    normal, along = (response["traction"].values[..., k] for k in (0, 1))
    np.testing.assert_allclose(-normal, response["nominal_pressure"].values[None], rtol=1e-6)
    slip = response["displacement_jump"].values[..., 1]
    for start in (0, 7):  # press, five steps to full slip, release
        there, end = start + 5, start + 6
        np.testing.assert_allclose(along[:, there] / (0.3 * -normal[:, there]), 1.0, atol=0.03)
        np.testing.assert_allclose(response["traction"].values[:, end], 0.0, atol=1e-9)
        np.testing.assert_allclose(slip[:, end], 0.0, atol=1e-12)
    alone = run_ensemble(cells, shear_path(cells[0], [pressures[1]], along="x", steps=5))
    second = response["traction"].values[:, 7:13]
    np.testing.assert_allclose(alone["traction"].values[:, :6], second, rtol=1e-5, atol=10.0)


def test_the_shear_of_flat_spots_is_carried_by_friction_and_on_slopes_by_both():
    """Dragged along its slopes a body is supported by pressures as well, eq. (3) of the source."""
    cell = two_bodies(12, 1)
    path = shear_path(cell, [0.1 * 0.05 * E_STAR], along="x", steps=5)
    response = run_ensemble([cell], path)
    whole = response["traction"].values[0, 5]
    pressing = response["traction_by_normal"].values[0, 5]
    assert 0.0 < abs(pressing[1]) < 0.1 * abs(whole[1])
    # Coulomb's law of the points: |t_T| = mu t_N, with vertical parts that differ by the square
    assert whole[1] - pressing[1] == pytest.approx(0.3 * -pressing[0], rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("opposite", [1.0, 3.0])
def test_sheared_cells_follow_the_bed(opposite):
    """Validation 10: initial ratio over 2 (1 - nu) / (2 - nu), and the whole path."""
    star = 1e9 / (1.0 - 0.3**2) / (1.0 + 1.0 / opposite)
    cells = [two_bodies(32, seed, opposite=opposite) for seed in range(2)]
    light = 0.05 * star * np.geomspace(5e-4, 0.15, 12)
    response = run_ensemble(cells, shear_path(cells[0], [0.1 * 0.05 * star]))
    law = fit_branches(run_ensemble(cells, Path(pressure=tuple(light))), shear=response)
    theory = 2.0 * (1.0 - 0.3) / (2.0 - 0.3)
    ratio, mu = float(law["shear_stiffness_ratio"].mean()), float(law["shear_friction"])
    assert mu == pytest.approx(0.3, rel=0.02)
    # alike bodies; unlike bodies slip as they are pressed
    assert 0.93 < ratio / theory < (1.05 if opposite == 1.0 else 1.0)
    apart = np.linalg.norm(law["shear_traction"] - law["shear_bed_traction"], axis=1)
    assert np.max(apart / (mu * law["shear_pressure"])) < (0.02 if opposite == 1.0 else 0.05)


def test_the_tangential_traction_has_a_budget_with_the_distance_from_the_bed(law, decay):
    ratio, mu = KAPPA * np.stack([scatter(0.03, 2)] * 2, axis=1), MU * scatter(0.02, 4)
    data, normal = sheared(decay, ratio, mu), pressed(decay)
    entry = with_shear(law, normal, data)
    budget = error_budget(normal, entry, tangential={})
    assert list(budget["quantity"].values)[-1] == "tangential_traction"
    row = budget["error_half_width"].sel(quantity="tangential_traction")
    whole = budget["error_total"].sel(quantity="tangential_traction")
    assert np.all(whole >= row.max("error_term"))
    at = np.searchsorted(WIDE, 2e7)
    bed = float(row.sel(error_term="friction bed")[at])
    assert bed < 0.01
    sampling = float(row.sel(error_term="sampling")[at])
    full = 2.571 * np.std(mu, ddof=1) / CELLS**0.5 / MU  # Student's, at full slip
    assert 0.7 * full < sampling < 2.0 * full
    # cells that are rounder than the bed: five hundredths of mu p too much half way
    data["traction"].values[..., 1] += 0.05 * MU * 2e7 * (data["traction"].values[..., 1] > 0.5e6)
    off = error_budget(normal, with_shear(law, normal, data), tangential={})
    there = off["error_half_width"].sel(quantity="tangential_traction", error_term="friction bed")
    assert 0.015 < float(there[at]) < 0.06
    # gap, area and stiffness are as without shear
    plain = error_budget(normal, law)
    assert "friction bed" not in plain.attrs["unknown"]
    part = budget["error_total"].sel(quantity=plain["quantity"])
    np.testing.assert_allclose(part, plain["error_total"])
    known = law_from_dataset(entry).gap_at(WIDE)
    sources = law_sources(with_budget(entry, budget))
    known = propagate("gap", sources, lambda item: item.gap_at(WIDE), known)
    np.testing.assert_array_equal(known["error_half_width"].sel(error_term="friction bed"), 0.0)


def test_coarser_grids_give_the_error_of_the_ratio(law, decay):
    fine, coarse = (
        with_shear(law, pressed(decay), sheared(decay, np.full((CELLS, 2), kappa)))
        for kappa in (0.8, 0.84)
    )
    response = pressed(decay)
    resolutions = {2.0: response.assign(mean_gap=1.001 * response["mean_gap"])}
    where = {"error_term": "micro discretisation"}
    for coarser, known in (({}, False), ({2.0: coarse}, True)):
        budget = error_budget(response, fine, resolutions=resolutions, tangential=coarser)
        row = budget["error_half_width"].sel(where)
        tangential, stiffness = (row.sel(quantity=q) for q in ("tangential_traction", "stiffness"))
        total = budget["error_total"].sel(quantity="tangential_traction")
        assert np.all(np.isfinite(total) == known)
    ratio = 1.25 * 0.04 / 0.8  # first order
    np.testing.assert_allclose(tangential, np.exp(-1.0) * np.hypot(stiffness, ratio), rtol=0.02)


def test_the_scales_of_another_structure_count_for_the_tangential_traction_too(measured, decay):
    computed, _ = measured
    budget = error_budget(pressed(decay), computed, tangential={})
    scaled = with_scales(with_budget(computed, budget), compare_scales(1e-4, 1e-3, 1e-2))
    row = scaled["error_half_width"].sel(error_term="scale separation")
    tangential, stiffness = (
        row.sel(quantity=name) for name in ("tangential_traction", "stiffness")
    )
    np.testing.assert_allclose(tangential, np.exp(-1.0) * stiffness)


def cycled(decay, lost=1.0, amplitude=1.0):
    """Cells that are pressed, sheared, sheared back and again, farther, and released.

    Each is the bed of an exponential law, in small steps, with ``lost`` times the loss of the bed.
    """
    way = np.concatenate(
        [np.linspace(*ends, 400) for ends in ((0, 1), (1, -1), (-1, 1), (1, 8 / amplitude))]
    )
    entry = [0, 200, 399, 599, 799, 999, 1199, 1399, 1599]
    slip, traction, work = [], [], []
    for item in decay:
        bed = Sliders(Exponential(SCALE, item), MU, KAPPA, pressures=(1e5, 1e9), slabs=400)
        u = amplitude * MU * DECAY / KAPPA * np.stack([way, 0.0 * way], axis=1)
        opening = np.full(way.size, float(bed.normal.gap_at(np.array(2e7))))
        t = bed_traction(bed, opening, u)[:, 0]
        stored = np.append(0.0, np.cumsum(np.diff(u[:, 0]) * 0.5 * (t[1:] + t[:-1])))
        slip.append(u[entry, 0])
        traction.append(t[entry])
        work.append(lost * stored[entry])
    response = sheared(decay, steps=8, pressures=(2e7,), along=(0,))
    response["displacement_jump"].values[:, :-1, 1] = slip
    response["traction"].values[:, :-1, 1] = traction
    response["slip_fraction"].values[:] = [0.5] * 8 + [1.0, 0.0]
    whole = np.pad(np.array(work), ((0, 0), (0, 1)), mode="edge")
    return MICRO_RESPONSE.assign(response, {"friction_work": whole})


@pytest.mark.parametrize("lost", [1.0, 1.1])
def test_the_loss_of_cycles_over_the_loss_of_the_bed_is_recovered(law, decay, lost):
    """Work over a closed cycle is its loss; here the bed itself makes it."""
    sheared = with_shear(law, pressed(decay), cycled(decay, lost))
    np.testing.assert_allclose(sheared["shear_loss_ratio"], lost, rtol=0.02)
    assert sheared["shear_cycle_pressure"].values.tolist() == [2e7]
    assert float(sheared["shear_cycle_amplitude"][0]) == pytest.approx(1.0 - np.exp(-1.0), rel=0.02)
    assert sheared["shear_loss_ratio_sample"].shape == (60, 2)
    INTERFACE_LAW.check(sheared)


def test_the_chance_of_few_cells_is_no_change_with_the_pressure():
    at, spread = np.repeat([6e6, 2e7, 6e7], 2), np.array([1.0, 1.1, 1.15])
    drawn = np.random.default_rng(seed=1).standard_normal((400, 8, 6))

    def half_width(ratio):
        return between_pressures(LossRatio(at, at, np.repeat(ratio[..., None], 2, -1)))

    level = 0.2 * drawn[0, :, :1]  # of cells, the same at all pressures
    exact = half_width(np.repeat(spread, 2) + level)
    assert exact == pytest.approx(1.96 * spread.std(ddof=1), rel=1e-3)
    chance = [half_width(1.0 + 0.1 * cells) for cells in drawn]
    assert np.median(chance) < 0.5 * 1.96 * 0.1 / np.sqrt(16)  # of each mean
    both = [half_width(np.repeat(spread, 2) + 0.1 * cells) for cells in drawn]
    assert np.sqrt(np.mean(np.square(both))) == pytest.approx(exact, rel=0.1)


@pytest.mark.parametrize("amplitude", [0.3, 1.0, 3.0])
def test_the_loss_of_a_bed_is_the_one_of_masings_rule(amplitude):
    """Under an exponential law t = mu p (1 - exp(-x)) with x = kappa u / (mu lambda)."""
    unit = MU * DECAY / KAPPA
    expected = MU * 2e7 * unit * (8.0 * (amplitude + np.expm1(-amplitude)))
    expected += 4.0 * MU * 2e7 * unit * amplitude * np.expm1(-amplitude)
    loss = bed_loss(Exponential(SCALE, DECAY), 2e7, amplitude * unit, KAPPA, MU)
    assert loss == pytest.approx(expected, rel=1e-9)


def test_a_cycle_lies_on_the_way_of_the_shear():
    cell = two_bodies(12, 1)
    plain, path = (shear_path(cell, [1e6], along="x", steps=5, cycle=c) for c in (0.0, 1.0))
    s = np.array(path.slide)[:, 0]
    assert len(path) == len(plain) + 4
    np.testing.assert_allclose(s[3:7], s[2] * np.array([s[3] / s[2], -1.0, -s[3] / s[2], 1.0]))
    np.testing.assert_array_equal(np.delete(s, np.s_[3:7]), np.array(plain.slide)[:, 0])

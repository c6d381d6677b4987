"""Cases of vibrating bodies: frequency and damping with intervals, and refusals."""

import re
from functools import partial

import numpy as np
import pytest

from multiscale.errors import CaseError, ConvergenceError
from multiscale.fe.mesh_file import box_mesh
from multiscale.io import open_law
from multiscale.macro.substructures.whole import assemble
from multiscale.pipeline import load_case, run
from multiscale.pipeline.body_sources import BodiesWithLaws, Change
from multiscale.pipeline.calibrated_law import _read, calibrate_case
from multiscale.pipeline.runner import job_in
from multiscale.pipeline.stage import Job
from multiscale.pipeline.stages.vibrating_bodies import (
    VIBRATING_BODIES,
    _laws,
    _press,
    _solve_changed,
    _solve_law,
    modes_of_law,
)
from multiscale.upscaling import (
    assume_shear,
    by_differences,
    law_from_dataset,
    read_vibration,
)
from multiscale.upscaling.budget import NORMAL
from multiscale.upscaling.measured.joints import BedCurve, Curve
from multiscale.upscaling.posterior_law import normal_law
from multiscale.upscaling.propagation import FEWEST_SAMPLES
from tests.pipeline.test_body_cases import HIGH, LONG, STATED, TEXT, WIDE, write_scattered_law
from tests.support import PORES, case_text, refused_rows, write_body, write_scene

DENSE = TEXT.replace("poissons_ratio = 0.3", 'poissons_ratio = 0.3\ndensity = "7850 kg/m^3"')
ONLY_PRESS = DENSE.replace(", { pull = 1 }", "")
VIBRATION = """
[vibration]
modes = [1, 2]
amplitudes = ["10 nm", "0.1 um"]
material_damping = 0.001
preload_friction = false
slabs = 192
"""
LARGER = VIBRATION.replace("[1, 2]", "[1]").replace('"10 nm", "0.1 um"', '"0.1 um", "0.3 um"')


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    """A folder with the meshes of housing and cover."""
    folder = tmp_path_factory.mktemp("meshes")
    size = (LONG, WIDE, HIGH)
    for name, place, counts in (("housing", 0.0, (3, 2, 1)), ("cover", HIGH, (2, 3, 1))):
        write_body(folder / f"{name}.msh", box_mesh(size, counts, origin=(0.0, 0.0, place)))
    return folder


def solve(folder, text, *pairs):
    """Run a case, and return its dataset and its page."""
    return run(
        load_case(write_scene(folder, text, *pairs)), folder / f"run_{len(list(folder.iterdir()))}"
    )


def test_a_case_has_modes_backbone_page_and_series(meshes):
    results = solve(meshes, ONLY_PRESS + VIBRATION)
    computed = results["vibration"]
    assert computed["step_mode"].values.tolist() == [1, 1, 2, 2]
    assert computed["converged"].all()
    slow, fast = computed["frequency"].values[:2]
    assert computed["mode_frequency"].values[0] > slow > fast
    damping = computed["damping"].values
    assert 0.001 < damping[0] < damping[1]
    assert list(meshes.rglob("vibration.pvd"))
    assert VIBRATING_BODIES.compared(computed)["frequency"].values[-1] == fast
    still = computed.assign(fall=0.0 * computed["fall"] - 1e-11)
    still["slipping_load"] = 0.0 * computed["slipping_load"] + 1e-17
    table = next(VIBRATING_BODIES.sections({"vibration": still}, meshes))
    head, rows = table.head, table.rows
    for name in ("fall (Hz)", "sliding force (%)"):  # rounding is not a number
        assert [row[head.index(name)] for row in rows] == ["0"] * 4


@pytest.mark.parametrize(("base", "patches", "sentence"), refused_rows("vibrating"))
def test_a_case_without_an_answer_is_refused_in_a_sentence(meshes, base, patches, sentence):
    with pytest.raises((CaseError, ConvergenceError), match=sentence):
        solve(meshes, ONLY_PRESS + VIBRATION, *patches)


def test_a_quick_run_reports_which_modes_and_amplitudes_it_leaves_out(meshes):
    many = VIBRATION.replace('"0.1 um"', '"20 nm", "50 nm", "0.1 um"')
    quick = load_case(write_scene(meshes, ONLY_PRESS + many)).quick()
    assert quick.vibration.modes == (1,)
    sentence = "--quick leaves out mode 2 and 1 of 4 amplitudes."
    assert sentence in str(run(quick, meshes / "quick")["vibration"].attrs["facts"])
    assert not load_case(write_scene(meshes, ONLY_PRESS + many)).vibration.left_out()


def test_a_free_structure_and_an_amplitude_that_slides_are_reported(meshes):
    """The press on the cover against the press on the housing holds both; nothing else does."""
    free = ONLY_PRESS.replace('supports = { bottom = "clamped" }\n', "").replace(
        "[statics]",
        '[[structure.loads]]\nname = "back"\nface = "housing.bottom"\n'
        'pressure = "10 MPa"\n[statics]',
    )
    pairs = [("press = 1 }", "press = 1, back = 1 }"), ("[1, 2]", "[1]"), ('"0.1 um"', '"1 mm"')]
    result = solve(meshes, free + VIBRATION, *pairs)["vibration"]
    assert "along x, along y, along z, about x, about y, about z are left out" in str(
        result.attrs["facts"]
    )
    assert result["converged"].values.tolist() == [1, 0]
    assert np.isnan(result["damping"].values[1])
    sentence = VIBRATING_BODIES.failure(result)
    assert re.search(r"mode 1 has no solution from the modal amplitude .* kg.1/2 m on", sentence)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [0, 40])
def test_intervals_follow_the_budget_of_the_law(meshes, samples):
    write_scattered_law(meshes / "law.nc", samples)
    text = ONLY_PRESS.replace(STATED, 'law = "law.nc"\n') + LARGER
    result = solve(meshes, text, ('"0.1 um", "0.3 um"', '"0.3 um"'))["vibration"]
    value = result["frequency"].values
    low, high = result["frequency_mean_law"].values
    assert np.all((low < value) & (value < high))
    half = result["error_half_width"].sel(error_term="sampling")
    assert np.all(half.sel(quantity="damping") > half.sel(quantity="frequency"))
    few = "4 of 40 bootstrap samples of the law, to first order"
    assert (result.attrs["how_sampling"] == few) == (samples == 40)
    assert np.isnan(result["error_total"].sel(quantity="damping")).all()  # no cell was cycled
    assert "the error of the loss of a cycle is not known" in result.attrs["cautions"]


UNCERTAIN = (
    ("friction = 0.2", 'friction = "0.2 +- 20 %"'),
    ('decay_length = "0.3 um"', 'decay_length = "0.3 um ± 0.03 um"'),
    ("material_damping = 0.001", "material_damping = 0"),
)


def test_stated_half_widths_reach_frequency_fall_and_damping(meshes):
    """Slip depends on amplitude over friction, so that a larger friction is a smaller amplitude."""
    near = ('"0.1 um", "0.3 um"', '"0.29 um", "0.3 um"')
    results = solve(meshes, ONLY_PRESS + LARGER, near, *UNCERTAIN)
    computed = results["vibration"]
    lines = ["interfaces[0].exponential.decay_length ± 10 %", "interfaces[0].friction ± 20 %"]
    assert computed["parameter"].values.tolist() == lines
    change, x = computed["sensitivity"], np.log(0.3 / 0.29)
    for name in ("fall", "damping"):
        slope = np.diff(np.log(computed[name].values))[0] / x
        of_friction = change.sel(quantity=name, parameter=lines[1]).mean("step")  # slabs are few
        np.testing.assert_allclose(of_friction, -0.2 * slope, rtol=0.1)
    stated = computed["error_half_width"].sel(error_term="stated values")
    np.testing.assert_allclose(stated, np.linalg.norm(change, axis=0), rtol=1e-12)
    total = computed["error_total"].values
    for kind in ("mean_law", "one_part"):
        ends = computed["frequency"].values * (1.0 + np.multiply.outer([-1.0, 1.0], total[0]))
        np.testing.assert_allclose(computed[f"frequency_{kind}"], ends, rtol=1e-12)
    heads = [section.heading for section in VIBRATING_BODIES.sections(results, meshes)]
    assert heads[-2:] == ["Error budget of the damping", "Sensitivity"]
    assert "intervals do not contain the error of the law" not in computed.attrs["cautions"]


@pytest.mark.slow
def test_intervals_of_stated_values_are_as_wide_as_samples_scatter(meshes):
    """Of 24 structures drawn from normal distributions, within the noise of so few."""
    case = load_case(write_scene(meshes, ONLY_PRESS + LARGER, *UNCERTAIN))
    result = run(case, meshes / "stated")["vibration"]
    bodies, rng = case.structure, np.random.default_rng(seed=5)
    jointed = BodiesWithLaws(bodies, case, [None])
    near = _press(jointed, _laws(jointed, Change()))[0]
    drawn = []
    for normal in rng.standard_normal((24, 2)) / 1.96:
        length = next(bodies.uncertain(1.0 + 0.1 * normal[0]))[2]
        both = next(length.uncertain(1.0 + 0.2 * normal[1]))[2]
        drawn.append(_solve_changed(jointed, near, Change(structure=both)))
    for name in ("frequency", "fall", "damping"):
        scatter = 1.96 * np.std([sample[name] for sample in drawn], axis=0) / result[name].values
        half = result["error_half_width"].sel(quantity=name, error_term="stated values").values
        assert np.all((half / scatter > 0.6) & (half / scatter < 1.7)), (half, scatter)


@pytest.mark.slow
def test_intervals_of_the_mean_law_are_as_wide_as_samples_scatter(meshes):
    """The samples of the law of 6 cells, each solved, scatter as far as the interval."""
    write_scattered_law(meshes / "law.nc", samples=FEWEST_SAMPLES)
    text = ONLY_PRESS.replace(STATED, 'law = "law.nc"\n') + LARGER.replace("192", "768")
    case = load_case(write_scene(meshes, text))
    result = run(case, meshes / "sampled")["vibration"]
    assert f"of {FEWEST_SAMPLES} bootstrap samples of the law" in result.attrs["how_sampling"]
    bodies = case.structure
    laws = bodies.read_laws(case, {}, lambda file, quick: open_law(file))
    jointed = BodiesWithLaws(bodies, case, laws)
    near = _press(jointed, _laws(jointed, Change()))[0]
    drawn = [
        _solve_changed(jointed, near, Change((0,), law_from_dataset(laws[0], sample)))
        for sample in range(laws[0].sizes["sample"])
    ]
    for name in ("frequency", "damping"):
        scatter = 1.96 * np.std([entry[name] for entry in drawn], axis=0) / result[name].values
        half = result["error_half_width"].sel(quantity=name, error_term="sampling").values
        assert np.all((half / scatter > 0.85) & (half / scatter < 1.15)), (half, scatter)


def bed_of(law, ratio, friction):
    """An interface of the stiffness of a law of cells, with a rate of its level."""
    x, normal = np.linspace(np.log(1e4), np.log(400e6), 300), law_from_dataset(law)
    stiffness = np.log(normal.stiffness(normal.gap_at(np.exp(x))))
    return BedCurve(Curve(x, stiffness, np.array([np.ones(x.size)])), ratio, friction)


@pytest.mark.slow
def test_the_gradient_of_a_small_vibration_is_the_rayleigh_quotient(meshes):
    """Of the frequency by the logarithm of the stiffness ratio, which the rest does not see."""
    write_scattered_law(meshes / "law.nc", samples=FEWEST_SAMPLES)
    vibration = LARGER.replace('"0.1 um", "0.3 um"', '"1e-6 um"').replace("0.001", "0")
    case = load_case(
        write_scene(meshes, ONLY_PRESS.replace(STATED, 'law = "law.nc"\n') + vibration)
    )
    law = assume_shear(open_law(meshes / "law.nc"), friction=0.2, stiffness_ratio=0.8)
    given = bed_of(law, 0.8, 0.2)
    # a table of two small amplitudes, and differences of .1 % at such an amplitude
    rows = ["amplitude (um), frequency (Hz), damping", "2e-6, 1000, 1e-3", "1e-6, 1000, 1e-3"]
    (meshes / "modes.csv").write_text("\n".join(rows))
    structure = partial(modes_of_law, case, law, {}, Job(meshes))
    table = read_vibration(meshes / "modes.csv", structure=structure, error=0.02)
    np.testing.assert_allclose(table.pressure, 10e6, rtol=0.05)  # of the press
    jointed = BodiesWithLaws(case.structure, case, [law])
    still, _ = _press(jointed, _laws(jointed, Change((0,), normal_law(law, given.curve))))
    answer = by_differences(partial(_solve_law, jointed, still))
    (frequency, _), gradient = answer(table, given, {})
    values, rates = table.answer(given, {})
    np.testing.assert_allclose(values[:2], frequency, rtol=1e-6)
    np.testing.assert_allclose(rates[:2, 1], gradient[0, 1], rtol=1e-3)
    rest, shape = still.rest, still.modes.shape[:, 0]
    whole = assemble(rest.free.with_locked_bolts())
    tangent = rest.law.respond(rest.state.jump, rest.law.unsheared(rest.state.history)).tangent
    moved = (whole.jump @ shape).reshape(3, -1)[1:]
    rate = np.einsum("p,ip,ijp,jp->", whole.weight, moved, tangent[1:, 1:], moved)
    assert gradient[0, 1] == pytest.approx(rate / (8.0 * np.pi**2 * frequency), rel=1e-6)


MEASURED = """
[law]
roughness = 0
discrepancy = 0
friction = 0.2
stiffness_ratio = 0.8
[[measured]]
file = "modes.csv"
kind = "vibration"
case = "structure.toml"
error = "2 %"
"""


@pytest.mark.slow
def test_measured_modes_of_a_structure_recover_the_friction_of_its_joint(meshes):
    """With damping of few slabs by the same structure of other friction and stiffness ratio."""
    write_scattered_law(meshes / "law.nc", samples=FEWEST_SAMPLES)
    cells = open_law(meshes / "law.nc")
    vibration = (
        LARGER.replace("0.001", "0")
        .replace("192", "48")
        .replace('"0.1 um", "0.3 um"', '"0.3 um", "0.6 um"')
    )
    text = ONLY_PRESS.replace(STATED, 'law = "law.nc"\n') + vibration
    structure = load_case(write_scene(meshes, text).rename(meshes / "structure.toml"))
    jointed = BodiesWithLaws(
        structure.structure, structure, [assume_shear(cells, friction=0.2, stiffness_ratio=0.8)]
    )
    near, _ = _press(jointed, _laws(jointed, Change()))
    true = _solve_law(jointed, near, None, bed_of(cells, 0.75, 0.25), {}).reshape(2, 2)
    rows = [f"{u}, {f}, {d}" for u, f, d in zip((0.3, 0.6), *true, strict=True)][::-1]
    (meshes / "modes.csv").write_text("\n".join(["amplitude (um), frequency (Hz), damping", *rows]))
    case = load_case(write_scene(meshes, case_text("conducting") + MEASURED))
    calibration = calibrate_case(case, cells, Job(meshes))
    friction = {row.name: row for row in calibration.parameters}["friction coefficient"]
    assert abs(friction.value - 0.25) < friction.half_width < 0.5 * friction.prior_half_width
    assert [row.unit for row in calibration.rows] == ["Hz", "Hz", "1", "1"]
    small = calibration.rows[-1]  # damping, of which few slabs are the largest error
    deviation = (small.predicted - small.measured) / small.residual
    assert deviation > 5.0 * 0.02 / NORMAL * small.measured


@pytest.mark.slow
def test_porous_bodies_with_measured_modes_have_their_volumes(meshes):
    """The volume of the case of the structure, and of a case that a body names."""
    write_scattered_law(meshes / "law.nc")
    volume = PORES.replace("[rve.recipe]", "voxels = 6\n[rve.recipe]\nrealisations = 2")
    (meshes / "volume.toml").write_text(volume)
    moduli = 'youngs_modulus = "210 GPa"\npoissons_ratio = 0.3\n'
    text = ONLY_PRESS.replace(STATED, 'law = "law.nc"\n') + LARGER.replace("192", "12")
    text += volume.replace('title = "Pores"', "")
    pairs = [(moduli, ""), (moduli, 'rve = "volume.toml"\n')]
    write_scene(meshes, text, *pairs).rename(meshes / "structure.toml")
    (meshes / "modes.csv").write_text("amplitude (um), frequency (Hz), damping\n0.1, 1e4, 0.01\n")
    case = load_case(write_scene(meshes, case_text("conducting") + MEASURED))
    law = assume_shear(open_law(meshes / "law.nc"), friction=0.2, stiffness_ratio=0.8)
    table = _read(case.measured[0], law, job_in(meshes / "measured"))
    np.testing.assert_allclose(table.pressure, 10e6, rtol=0.05)  # of the press
    places = (meshes / "measured" / "volumes").iterdir()
    assert {place.name.split("-")[0] for place in places} == {"structure", "volume"}


def test_another_volume_of_a_body_asks_for_another_backbone(meshes):
    """The checksum of the stage changes with [rve], of which the cover takes its stiffness."""
    moduli = 'youngs_modulus = "210 GPa"\npoissons_ratio = 0.3\n'
    assert moduli in ONLY_PRESS
    volume = PORES.replace('title = "Pores"', "")
    text = ONLY_PRESS.replace(moduli, "", 1) + VIBRATION + volume
    first, again, other = (
        VIBRATING_BODIES.identity(load_case(write_scene(meshes, text, *pairs)))
        for pairs in ((), (), (("porosity = 0.1", "porosity = 0.2"),))
    )
    assert first == again != other

"""Two-scale fatigue against closed forms, an independent integration, and single cycles."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from multiscale.micro.damage import FatigueMaterial, two_scale_fatigue, woehler_curve
from multiscale.micro.damage.fatigue import STATE_SIZE, FatigueProgress, Inclusions
from multiscale.micro.damage.inclusion import damage_rate, effective_stress, run_cycles
from multiscale.schema import FATIGUE, WOEHLER
from tests.closed_forms.fatigue import damage_per_cycle, plastic_strain_per_cycle, reversed_life
from tests.support import observed_rate

E, NU, LIMIT, STRENGTH = 200e9, 0.3, 200e6, 0.5e6
PLAIN = FatigueMaterial(E, NU, LIMIT, STRENGTH, threshold=0.05, feedback=False)
FULL = FatigueMaterial(E, NU, LIMIT, STRENGTH, 2.0, hardening=20e9, threshold=0.05, closure=0.2)


def reversed_stress(amplitude):
    return np.array([amplitude, -amplitude])


def lives(history, material, **options):
    fatigue = two_scale_fatigue(history, material, **options)
    FATIGUE.check(fatigue)
    return float(fatigue["cycles_to_rupture"])


# --- closed forms ----------------------------------------------------------------------------


# validation: K = 120879.1 MPa; dp, dD, N_D and N_R at 210 and 250 MPa
@pytest.mark.parametrize(
    ("amplitude", "dp", "dD", "initiation", "rupture"),
    [
        (210e6, 3.30909e-4, 6.61892e-5, 151.1, 4683.6),
        (250e6, 1.654545e-3, 3.318283e-4, 30.22, 934.3),
    ],
)
def test_reversed_tension_has_its_closed_form(amplitude, dp, dD, initiation, rupture):
    plastic = plastic_strain_per_cycle(amplitude, E, NU, LIMIT)
    damage = damage_per_cycle(amplitude, E, NU, LIMIT, STRENGTH)
    assert plastic == pytest.approx(dp, rel=2e-6)
    assert damage == pytest.approx(dD, rel=2e-6)
    assert reversed_life(plastic, damage, 0.05, 0.3) == pytest.approx(rupture, rel=2e-5)
    for tolerance in (None, 0.02):
        fatigue = two_scale_fatigue(reversed_stress(amplitude), PLAIN, jump_tolerance=tolerance)
        assert float(fatigue["cycles_to_rupture"]) == pytest.approx(rupture, rel=5e-3)
        assert float(fatigue["cycles_to_initiation"]) == pytest.approx(initiation, abs=1.0)
    # from the state of a run: within .1 %, here to round-off
    state = np.zeros(STATE_SIZE)
    path = reversed_stress(amplitude)[:, None] * np.eye(6)[0]
    run_cycles(state, path, 5, PLAIN.parameters(), 1)
    before = state.copy()
    run_cycles(state, path, 1, PLAIN.parameters(), 1)
    assert state[1] - before[1] == pytest.approx(plastic, rel=1e-10)


@pytest.mark.parametrize("amplitude", [1e6, 150e6, 199.99e6, 200e6])
def test_below_the_limit_there_is_no_end(amplitude):
    fatigue = two_scale_fatigue(reversed_stress(amplitude), FULL)
    assert float(fatigue["cycles_to_rupture"]) == np.inf
    assert int(fatigue["run_out"]) == 1
    assert float(fatigue["computed_cycles"]) < 5


def test_a_mean_stress_shakes_down_with_hardening():
    """The first load flows; then the back stress has moved the surface and nothing does."""
    fatigue = two_scale_fatigue(np.array([350e6, 0.0]), FULL)
    assert int(fatigue["run_out"]) == 1
    assert float(fatigue["plastic_strain"][-1]) > 0.0


# --- localisation ----------------------------------------------------------------------------


def localised(stress, damage, plastic, poissons_ratio):
    """Effective stress of the inclusion from Eshelby's equivalent inclusion, tensors as (9,)."""
    nu = poissons_ratio
    first, delta = np.eye(9), np.eye(3)
    volume = np.outer(delta, delta)
    # Eshelby's tensor of a ball, J. D. Eshelby, Proc. R. Soc. A 241 (1957) 376-396
    ball = (5.0 * nu - 1.0) / (15.0 * (1.0 - nu)) * volume
    ball = ball + 2.0 * (4.0 - 5.0 * nu) / (15.0 * (1.0 - nu)) * first  # on symmetric tensors
    lame, shear = E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu)), E / (2.0 * (1.0 + nu))
    C = lame * volume + 2.0 * shear * first
    far = np.linalg.solve(C, stress)
    # (1 - D) C (far + S e - plastic) = C (far + S e - e)
    matrix = C - damage * C @ ball
    e = np.linalg.solve(matrix, damage * C @ far + (1.0 - damage) * C @ plastic)
    return C @ (far + ball @ e - plastic)


@pytest.mark.parametrize("damage", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("poissons_ratio", [0.0, 0.3, 0.45])
def test_the_stress_of_the_inclusion_equals_the_equivalent_inclusion(damage, poissons_ratio):
    rng = np.random.default_rng(seed=2)
    stress, plastic = rng.normal(size=(2, 3, 3))
    stress, plastic = 1e8 * (stress + stress.T), 1e-3 * (plastic + plastic.T)
    plastic -= np.trace(plastic) / 3.0 * np.eye(3)
    expected = localised(stress.ravel(), damage, plastic.ravel(), poissons_ratio).reshape(3, 3)
    i, j = np.array([(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]).T
    state = np.zeros(STATE_SIZE)
    state[0], state[2:8] = damage, plastic[i, j]
    parameters = dataclasses.replace(FULL, poissons_ratio=poissons_ratio).parameters()
    nu, computed = poissons_ratio, np.empty(6)
    shear, b = E / (2.0 * (1.0 + nu)), 2.0 * (4.0 - 5.0 * nu) / (15.0 * (1.0 - nu))
    effective_stress(state, np.zeros(6), stress[i, j], 1.0, parameters, shear, b, computed)
    np.testing.assert_allclose(computed, expected[i, j], rtol=1e-10, atol=1e-3)


# --- the increments --------------------------------------------------------------------------


def slopes(path_rate, material):
    """Rates of plastic strain and back stress on the yield surface, written out in tensors."""
    G = E / (2.0 * (1.0 + NU))
    b = 2.0 * (4.0 - 5.0 * NU) / (15.0 * (1.0 - NU))

    def rate(_, y, stress):
        plastic, back = y[:9].reshape(3, 3), y[9:18].reshape(3, 3)
        deviator = stress - np.trace(stress) / 3.0 * np.eye(3)
        xi = deviator - 2.0 * G * (1.0 - b) * plastic - back
        drive = path_rate - np.trace(path_rate) / 3.0 * np.eye(3)
        n = 1.5 * xi / np.sqrt(1.5 * np.sum(xi**2))
        multiplier = max(0.0, np.sum(n * drive)) / (3.0 * G * (1.0 - b) + material.hardening)
        flow = multiplier * n
        return np.concatenate(
            [flow.ravel(), (2.0 / 3.0 * material.hardening * flow).ravel(), [multiplier]]
        )

    return rate


def test_a_path_that_turns_follows_the_rate_equations_exactly():
    material = dataclasses.replace(PLAIN, hardening=30e9, threshold=1.0)
    first, second = np.diag([LIMIT, 0.0, 0.0]), np.diag([LIMIT, 0.0, 0.0])
    second[0, 1] = second[1, 0] = 200e6
    rate = slopes(second - first, material)
    exact = solve_ivp(
        lambda t, y: rate(t, y, first + t * (second - first)),
        (0.0, 1.0),
        np.zeros(19),
        rtol=1e-10,
        atol=1e-16,
    ).y[18, -1]
    path = np.array([[LIMIT, 0, 0, 0, 0, 0], [LIMIT, 0, 0, 0, 0, 200e6]])
    for substeps in (1, 16):
        state = np.zeros(STATE_SIZE)
        run_cycles(state, path, 1, material.parameters(), substeps)
        assert state[1] == pytest.approx(exact, rel=1e-7)


def test_a_straight_pull_is_integrated_exactly_from_the_threshold_on():
    """The energy is quadratic along it, and the damage follows from the strain beyond."""
    results = []
    for threshold, substeps in ((0.0, 1), (0.0, 64), (4e-4, 1)):
        material = dataclasses.replace(PLAIN, hardening=20e9, threshold=threshold)
        state = np.zeros(STATE_SIZE)
        run_cycles(state, 1.5 * LIMIT * np.eye(6)[:1], 1, material.parameters(), substeps)
        results.append(state[:2])
    (once, p), (fine, _), (late, _) = results
    assert once == pytest.approx(fine, rel=1e-9)
    assert late == pytest.approx(once * (1.0 - 4e-4 / p), rel=1e-9)
    assert 0.1 < 4e-4 / p < 0.9


@pytest.mark.slow
def test_substeps_for_the_damage_are_of_second_order():
    angle = np.arange(8) * np.pi / 4.0
    path = np.zeros((8, 6))
    path[:, 0], path[:, 5] = np.cos(angle), np.sin(angle) / np.sqrt(3.0)
    substeps = np.array([1, 2, 4, 64])
    counts = [
        lives(1.1 * LIMIT * path, FULL, jump_tolerance=None, substeps=int(n)) for n in substeps
    ]
    errors = np.abs(np.array(counts[:3]) / counts[3] - 1.0)
    assert observed_rate(1.0 / substeps[:3], errors) == pytest.approx(2.0, abs=0.5)
    assert abs(lives(1.1 * LIMIT * path, FULL, jump_tolerance=None) / counts[3] - 1.0) < 1e-3


def test_turning_the_axes_changes_nothing():
    q, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    rng = np.random.default_rng(4)
    corners = rng.uniform(-180e6, 180e6, (4, 3, 3))
    corners = corners + corners.transpose(0, 2, 1)

    def as_path(tensors):
        i, j = np.array([(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]).T
        return tensors[:, i, j]

    life = lives(as_path(corners), FULL, jump_tolerance=None)
    other = lives(as_path(q @ corners @ q.T), FULL, jump_tolerance=None)
    assert np.isfinite(life)
    assert other == pytest.approx(life, rel=1e-9)


@pytest.mark.parametrize("damage", [0.0, 0.4, 0.95])
@pytest.mark.parametrize("closure", [0.0, 0.2, 1.0])
def test_the_energy_that_drives_damage_has_its_closed_form(damage, closure):
    stress = 1e8 * np.random.default_rng(seed=6).normal(size=(3, 3))
    stress = stress + stress.T
    closed = closure * ((1.0 - damage) / (1.0 - closure * damage)) ** 2
    principal = np.linalg.eigvalsh(stress)
    assert principal[0] < 0.0 < principal[-1]
    for sign in (1.0, -1.0):
        values, trace = sign * principal, sign * np.trace(stress)
        open_part = np.sum(values[values > 0.0] ** 2), max(trace, 0.0) ** 2
        closed_part = np.sum(values[values < 0.0] ** 2), min(trace, 0.0) ** 2
        both = [a + closed * c for a, c in zip(open_part, closed_part, strict=True)]
        energy = ((1.0 + NU) * both[0] - NU * both[1]) / (2.0 * E)
        i, j = np.array([(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]).T
        parameters = dataclasses.replace(FULL, closure=closure).parameters()
        rate = damage_rate(sign * stress[i, j], damage, parameters)
        assert rate == pytest.approx((energy / STRENGTH) ** 2, rel=1e-10)


def test_damage_in_the_localisation_shortens_the_life():
    feedback = dataclasses.replace(PLAIN, feedback=True)
    assert lives(reversed_stress(230e6), feedback) < 0.8 * lives(reversed_stress(230e6), PLAIN)


def test_units_do_not_matter():
    small = dataclasses.replace(
        FULL, youngs_modulus=E * 1e-9, fatigue_limit=0.2, damage_strength=5e-4, hardening=20.0
    )
    expected = lives(reversed_stress(220e6), FULL)
    assert lives(reversed_stress(0.22), small) == pytest.approx(expected, rel=1e-9)


# --- cycle jumps -----------------------------------------------------------------------------


@pytest.mark.parametrize("amplitude", [201e6, 220e6, 260e6])
def test_jumps_agree_with_every_cycle_for_a_tenth_of_them(amplitude):
    every = lives(reversed_stress(amplitude), FULL, jump_tolerance=None)
    fatigue = two_scale_fatigue(reversed_stress(amplitude), FULL)
    assert float(fatigue["cycles_to_rupture"]) == pytest.approx(every, rel=0.01)
    assert float(fatigue["computed_cycles"]) < 0.11 * every


def test_the_error_falls_with_the_tolerance_of_the_jumps():
    every = lives(reversed_stress(202e6), FULL, jump_tolerance=None)
    tolerances = (0.1, 0.03, 0.01, 0.003)
    runs = [two_scale_fatigue(reversed_stress(202e6), FULL, jump_tolerance=t) for t in tolerances]
    errors = [abs(float(run["cycles_to_rupture"]) / every - 1.0) for run in runs]
    assert errors[0] < 0.01
    assert np.all(np.diff(errors) <= 1e-9)
    assert errors[-1] < 1e-4


def program(*blocks):
    """Path of a program of reversed cycles, from pairs of amplitude and count."""
    return np.concatenate([np.tile(reversed_stress(size), count) for size, count in blocks])


BLOCKS = (210e6, 10), (150e6, 20), (230e6, 1)


def test_a_program_of_cycles_is_repeated_as_a_whole():
    every = lives(program(*BLOCKS), FULL, jump_tolerance=None)
    assert lives(program(*BLOCKS), FULL) == pytest.approx(every, rel=0.01)
    # elastic cycles change nothing
    assert lives(program(BLOCKS[0], BLOCKS[2]), FULL, jump_tolerance=None) == pytest.approx(
        every, rel=0.01
    )


def test_the_order_of_blocks_matters_little_when_they_are_short():
    life = lives(program(*BLOCKS), PLAIN)
    assert lives(program(*BLOCKS[::-1]), PLAIN) == pytest.approx(life, rel=0.02)
    # linear accumulation without feedback: Palmgren and Miner's sum of damage beyond the onset
    damage = 10 * damage_per_cycle(210e6, E, NU, LIMIT, STRENGTH)
    damage += damage_per_cycle(230e6, E, NU, LIMIT, STRENGTH)
    plastic = 10 * plastic_strain_per_cycle(210e6, E, NU, LIMIT)
    plastic += plastic_strain_per_cycle(230e6, E, NU, LIMIT)
    assert life == pytest.approx(0.05 / plastic + 0.3 / damage, rel=0.02)


def test_what_does_not_end_in_time_is_not_called_a_life():
    for tolerance in (None, 0.02):
        fatigue = two_scale_fatigue(
            reversed_stress(210e6), PLAIN, max_cycles=1000, jump_tolerance=tolerance
        )
        assert int(fatigue["converged"]) == 0
        assert np.isnan(float(fatigue["cycles_to_rupture"]))
        assert float(fatigue["cycles"][-1]) == 1000.0


def test_damage_never_heals():
    fatigue = two_scale_fatigue(program(*BLOCKS), FULL)
    for name in ("cycles", "damage", "plastic_strain"):
        assert np.all(np.diff(fatigue[name]) >= 0.0)
    assert float(fatigue["damage"][-1]) == pytest.approx(0.3)


def test_a_woehler_curve_falls_to_the_limit():
    amplitudes = np.array([190e6, 200.1e6, 205e6, 220e6, 300e6])
    curve = woehler_curve(FULL, amplitudes)
    WOEHLER.check(curve)
    life = curve["cycles_to_rupture"].values
    assert life[0] == np.inf
    assert np.all(np.diff(life[1:]) < 0.0)
    assert curve["converged"].values.all()
    pulsating = woehler_curve(PLAIN, np.array([230e6]), stress_ratio=0.0)
    assert int(pulsating["run_out"][0]) == 0


# --- refusals --------------------------------------------------------------------------------


def test_a_jump_that_would_end_broken_is_shortened_until_it_is_not():
    """Damage that grows faster and faster, where a trial ends sound and the jump would not."""
    passes = 0

    def compute(run, count):
        nonlocal passes
        passes += 1
        assert passes < 10_000, "the same jump is tried for ever"
        run.state[:, 0] += 8.5e-5 * (1.0 + 1.64 * run.state[:, 0])
        run.state[:, 1] += 8.5e-5
        run.cycles += 1
        run.broken = run.state[:, 0] >= 1.0

    state = np.zeros((1, STATE_SIZE))
    state[:, 1] = 1e-3  # beyond the threshold
    material = SimpleNamespace(hardening=1.0, feedback=1.0, threshold=0.0, critical_damage=1.0)
    run = FatigueProgress.begin(state)
    Inclusions(material, np.ones(1), 0.2).pass_cycles(run, compute, 60_000, lambda run: None)
    assert run.broken.all()
    # the closed form of dD/dN = r (1 + a D)
    assert run.cycles[0] == pytest.approx(np.log(2.64) / (8.5e-5 * 1.64), rel=0.05)

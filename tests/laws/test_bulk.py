"""Properties of every bulk law, and of plasticity in particular."""

import numpy as np
import pytest

from multiscale.laws.bulk import J2, AnisotropicElastic, Elastic, NeoHookean, Prony, respond_bulk

E, NU = 2.0, 0.3
VISCOUS = Prony(E, NU, weights=(0.4, 0.3), times=(1.0, 20.0), time_step=2.0)
SOFT = J2(E, NU, 0.05, 0.1, saturation_stress=0.1, saturation_rate=5.0)
LAME, MU = E * NU / ((1 + NU) * (1 - 2 * NU)), E / (2 * (1 + NU))
ISOTROPIC = np.diag([2.0 * MU] * 3 + [MU] * 3) + LAME * np.pad(np.ones((3, 3)), (0, 3))
LAWS = [
    pytest.param(Elastic(E, NU), id="elastic"),
    pytest.param(AnisotropicElastic(ISOTROPIC), id="elastic, tensor"),
    pytest.param(NeoHookean(E, NU), id="neo-Hookean"),
    pytest.param(J2(E, NU, 5.0), id="J2, elastic"),
    pytest.param(SOFT, id="J2, flowing"),
    pytest.param(VISCOUS.over(0.0), id="Prony, at once"),
    pytest.param(VISCOUS, id="Prony, in time"),
]
FINITE = LAWS[2:]
POINTS = 20


def gradients(size, seed):
    noise = np.random.default_rng(seed).normal(size=(3, 3, POINTS))
    return np.eye(3)[:, :, None] + size * noise


def committed(law):
    """A state that has seen some deformation."""
    rest = law.initial_state((POINTS,))
    return respond_bulk(law, gradients(0.1, seed=3), rest).state


def rotations(seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(POINTS, 3, 3)))
    q *= np.linalg.det(q)[:, None, None]
    return np.moveaxis(q, 0, 2)


@pytest.mark.parametrize("law", LAWS)
def test_the_tangent_is_the_derivative_of_the_stress(law):
    F, state = gradients(0.15, seed=1), committed(law)
    tangent = respond_bulk(law, F, state).tangent
    for k in range(3):
        for m in range(3):
            step = np.zeros_like(F)
            step[k, m] = 1e-6
            change = (
                respond_bulk(law, F + step, state).stress
                - respond_bulk(law, F - step, state).stress
            )
            np.testing.assert_allclose(tangent[:, :, k, m], change / 2e-6, atol=1e-8)


def test_a_tensor_answers_with_all_its_entries():
    noise = np.random.default_rng(seed=4).normal(size=(6, 6))
    C = noise @ noise.T
    law = AnisotropicElastic(C)
    H = np.random.default_rng(seed=5).normal(size=(3, 3))
    strain = np.array([H[0, 0], H[1, 1], H[2, 2], H[1, 2] + H[2, 1], H[0, 2] + H[2, 0]])
    stress = C @ np.append(strain, H[0, 1] + H[1, 0])
    entry = respond_bulk(law, np.eye(3) + H, np.empty(0)).stress
    np.testing.assert_allclose(entry, stress[[[0, 5, 4], [5, 1, 3], [4, 3, 2]]], rtol=1e-12)
    # both parts of the energy are convex, so that no element gains from a change of volume
    shape = C - law.lame * np.pad(np.ones((3, 3)), (0, 3))
    assert law.lame >= 0.0
    assert np.linalg.eigvalsh(shape)[0] > -1e-12


@pytest.mark.parametrize("law", LAWS[:-1])
def test_small_strain_is_hookes_law(law):
    small = 1e-7 * np.random.default_rng(seed=2).normal(size=(3, 3, POINTS))
    F = np.eye(3)[:, :, None] + small
    stress = respond_bulk(law, F, law.initial_state((POINTS,))).stress
    strain = 0.5 * (small + small.swapaxes(0, 1))
    expected = LAME * np.trace(strain) * np.eye(3)[:, :, None] + 2 * MU * strain
    np.testing.assert_allclose(stress, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("law", FINITE)
def test_a_rotation_turns_the_stress_with_it(law):
    F, R, state = gradients(0.15, seed=5), rotations(seed=6), committed(law)
    turned = respond_bulk(law, np.einsum("ijp,jkp->ikp", R, F), state)
    still = respond_bulk(law, F, state)
    expected = np.einsum("ijp,jkp->ikp", R, still.stress)
    np.testing.assert_allclose(turned.stress, expected, atol=1e-13)
    np.testing.assert_allclose(turned.state, still.state, atol=1e-13)


@pytest.mark.parametrize("law", FINITE)
def test_the_cauchy_stress_is_symmetric(law):
    F = gradients(0.15, seed=7)
    P = respond_bulk(law, F, committed(law)).stress
    kirchhoff = np.einsum("ikp,jkp->ijp", P, F)
    np.testing.assert_allclose(kirchhoff, kirchhoff.swapaxes(0, 1), atol=1e-13)


@pytest.mark.parametrize("law", LAWS)
def test_points_do_not_see_each_other_and_arguments_stay(law):
    F, state = gradients(0.15, seed=8), committed(law)
    before = F.copy(), state.copy()
    together = respond_bulk(law, F, state)
    alone = respond_bulk(law, F[:, :, 4], state[:, 4])
    np.testing.assert_allclose(alone.stress, together.stress[:, :, 4], atol=1e-14)
    np.testing.assert_allclose(alone.state, together.state[:, 4], atol=1e-14)
    np.testing.assert_array_equal(F, before[0])
    np.testing.assert_array_equal(state, before[1])


def test_flow_ends_on_the_yield_surface_and_keeps_the_volume():
    F, state = gradients(0.15, seed=9), committed(SOFT)
    response = respond_bulk(SOFT, F, state)
    kirchhoff = np.einsum("ikp,jkp->ijp", response.stress, F)
    deviator = kirchhoff - np.trace(kirchhoff) / 3.0 * np.eye(3)[:, :, None]
    equivalent = np.sqrt(1.5 * np.sum(deviator**2, axis=(0, 1)))
    yielded = response.state[6] > state[6]
    assert yielded.sum() > POINTS / 2
    limit = SOFT.flow_stress(response.state[6])[0]
    np.testing.assert_allclose(equivalent[yielded], limit[yielded], rtol=1e-12)
    assert np.all(equivalent <= limit * (1.0 + 1e-12))
    row = response.state[:6]
    Cp = np.array([[row[0], row[3], row[5]], [row[3], row[1], row[4]], [row[5], row[4], row[2]]])
    volume = np.linalg.det(np.moveaxis(Cp, 2, 0) + np.eye(3))
    np.testing.assert_allclose(volume, 1.0, rtol=1e-12)


def test_plastic_work_is_never_negative():
    state, dissipated = SOFT.initial_state((POINTS,)), np.zeros(POINTS)
    for seed in range(6):
        new = respond_bulk(SOFT, gradients(0.1, seed), state).state
        assert np.all(new[6] >= state[6])
        dissipated += SOFT.flow_stress(new[6])[0] * (new[6] - state[6])
        state = new
    assert np.all(dissipated > 0.0)


def test_a_repeated_deformation_flows_no_further():
    F = gradients(0.15, seed=10)
    first = respond_bulk(SOFT, F, committed(SOFT))
    again = respond_bulk(SOFT, F, first.state)
    np.testing.assert_allclose(again.state, first.state, atol=1e-13)
    np.testing.assert_allclose(again.stress, first.stress, atol=1e-13)


def test_simple_tension_follows_the_hardening_curve():
    law = J2(200e9, 0.3, 700e6, 300e6)
    plastic = 0.2
    stress = 700e6 + 300e6 * plastic  # Kirchhoff, in tension
    along = stress / 200e9 + plastic
    across = -0.3 * stress / 200e9 - 0.5 * plastic
    F = np.diag(np.exp([along, across, across]))
    response = respond_bulk(law, F, law.initial_state(()))
    kirchhoff = response.stress @ F.T
    np.testing.assert_allclose(np.diag(kirchhoff), [stress, 0.0, 0.0], atol=1e-6 * stress)
    assert response.state[6] == pytest.approx(plastic, rel=1e-9)


def test_a_constant_shear_relaxes_as_the_prony_series():
    F = np.eye(3)
    F[0, 1] = 0.3
    law = VISCOUS.over(0.0)
    first = respond_bulk(law, F, law.initial_state(()))
    state, times = first.state, np.array([0.5, 1.0, 4.0, 30.0])
    for before, now in zip(np.array([0.0, *times]), times, strict=False):
        response = respond_bulk(law.over(now - before), F, state)
        state = response.state
        share = 1.0 - 0.4 * (1.0 - np.exp(-now)) - 0.3 * (1.0 - np.exp(-now / 20.0))
        assert response.stress[0, 1] == pytest.approx(share * first.stress[0, 1], rel=1e-12)

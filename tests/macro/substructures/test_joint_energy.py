"""No step of a joint gains energy, and a law with a gaining step is reported."""

from dataclasses import replace

import numpy as np
import pytest

from multiscale.errors import ConvergenceError
from multiscale.laws import Exponential, HystereticLaw, InterfaceLaw, Response, Sliders, Sliding
from multiscale.laws.bulk import Elastic
from multiscale.laws.interface_law import advance_state
from multiscale.macro.bodies import stacked_blocks
from multiscale.macro.substructures import cut_assembly, solve_latin
from tests.cut_methods import solve_schur

NORMAL, KAPPA = Exponential(1e9, 0.25e-6), 0.8
STEEL = Elastic(210e9, 0.3)


class OneSpring(InterfaceLaw):
    """One spring of stiffness kappa K(g) without slip; the state is its traction and the jump."""

    n_state = 5

    def respond(self, jump, state):
        k = KAPPA * NORMAL.stiffness(jump[0])
        traction = np.stack([-NORMAL.pressure(jump[0]), *(state[:2] + k * (jump[1:] - state[3:]))])
        return Response(traction, np.zeros((3, *jump.shape)), np.concatenate([traction[1:], jump]))

    def sliding(self, jump, state):
        new = self.respond(jump, state).state
        before, after = (
            0.5 * np.sum(entry[:2] ** 2, axis=0) / (KAPPA * NORMAL.stiffness(entry[2]))
            for entry in (state, new)
        )
        work = np.sum(new[:2] * (jump[1:] - state[3:]), axis=0)
        return Sliding(0.0 * work, work - (after - before), after, new)


class Winning(Sliders):
    """A bed of sliders with steps that gain a little of their stored energy."""

    def sliding(self, jump, state):
        account = super().sliding(jump, state)
        return replace(account, dissipated=-2e-12 * account.stored)


def shear_at_a_high_pressure_and_back_at_a_low_one():
    gap = NORMAL.gap_at(np.array([1e8, 1e8, 2e7, 2e7, 1e8]))
    shear = np.array([0.0, 1e-8, 1e-8, 0.0, 0.0])
    return np.stack([gap, shear, 0.0 * shear]).T[:, :, None]


def test_one_spring_gains_energy_where_the_pressure_falls_and_is_reported():
    """Of t = kappa K d = 3.2 MPa: E = t^2 / (2 kappa K) grows from .016 to .08 J/m2."""
    law, jumps = OneSpring(), shear_at_a_high_pressure_and_back_at_a_low_one()
    state, _ = advance_state(law, jumps[0], np.zeros((5, 1)))
    state, _ = advance_state(law, jumps[1], state)
    with pytest.raises(ConvergenceError, match=r"a step gains 0\.064 J/m2 at a point of a joint"):
        advance_state(law, jumps[2], state)


def test_a_bed_of_sliders_dissipates_energy_there():
    law, lost = Sliders(NORMAL, 0.3, KAPPA, pressures=(1e6, 1e8)), []
    jumps = shear_at_a_high_pressure_and_back_at_a_low_one()
    state = law.at_rest(jumps[0])
    for jump in jumps:
        state, account = advance_state(law, jump, state)
        lost.append(account.dissipated[0])
    assert lost[2] == pytest.approx(0.8 * 0.016, rel=0.05)  # of the springs that leave contact


@pytest.mark.parametrize("solve", [solve_latin, solve_schur])
def test_solvers_refuse_a_step_that_gains_energy(solve):
    law = Winning(NORMAL, 0.3, KAPPA, pressures=(1e6, 1e8))
    blocks = stacked_blocks((0.02, 0.02, 0.01), (2, 2, 1), [STEEL] * 2, [law])
    with pytest.raises(ConvergenceError, match="J/m2 at most: Winning is wrong, as is every"):
        solve(cut_assembly(blocks), np.array([[2e7, 1e6], [1e7, 1e6]]))


def test_metal_that_flows_and_slips_is_solved_alike_by_both_solvers():
    metal = HystereticLaw(Exponential(1e9, 0.2e-6), 2.5, 1.6)
    law = Sliders(metal, 0.3, KAPPA, pressures=(1e6, 1e8), slabs=16)
    problem = cut_assembly(stacked_blocks((0.02, 0.02, 0.01), (2, 2, 1), [STEEL] * 2, [law]))
    path = np.array([[1e7, 0.0], [2e7, 2e6], [8e6, 1e6], [3e7, -2e6]])
    first, second = solve_latin(problem, path), solve_schur(problem, path)
    assert first.converged.values.all()
    assert second.converged.values.all()
    assert second.iterations.values.max() <= 15
    size = np.abs(second.displacement.values).max()
    np.testing.assert_allclose(first.displacement, second.displacement, atol=1e-6 * size)

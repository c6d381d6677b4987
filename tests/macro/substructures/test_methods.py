"""The method that solves bodies with joints is the cheapest method."""

import pytest

from multiscale.macro import AssembledNewton, LatinMethod, MultigridNewton
from multiscale.macro.substructures import JointSize, choose_method

LAP = JointSize(8000, 220, 2, 23)
LONG = JointSize(24000, 325, 2, 75)
GIGABYTE = 1e9


def method(size, asked=None, memory=10.0 * GIGABYTE):
    return choose_method(size, asked, memory=memory).taken.method


def test_the_whole_is_taken_where_it_fits_and_no_other_method_is_twice_as_fast():
    assert method(LAP) == AssembledNewton()
    assert method(LONG) == LatinMethod()  # the whole would be factorised in every Newton step


def test_a_requested_method_is_taken():
    asked = LatinMethod((2, 1))
    choice = choose_method(LAP, asked, memory=GIGABYTE)
    assert choice.taken.method == asked
    assert choice.why == "it is the choice of the case"
    assert [cost.method for cost in choice.others] == [AssembledNewton(), LatinMethod()]
    choice = choose_method(LONG, AssembledNewton(), memory=GIGABYTE)
    assert choice.taken.method == AssembledNewton()
    assert choice.why == "it is the choice of the case"


def test_rigid_contact_goes_to_latin():
    choice = choose_method(JointSize(8000, 220, 2, 23, compliant=False), memory=10.0 * GIGABYTE)
    assert choice.taken.method == LatinMethod()
    assert "rigid contact" in choice.why


def test_factors_that_do_not_fit_are_cut_until_they_do():
    large = JointSize(1_000_000, 4000, 2, 10, compliant=False)  # without a tangent for multigrid
    choice = choose_method(large, memory=50.0 * GIGABYTE)
    assert choice.others[0].memory > 50.0 * GIGABYTE >= choice.taken.memory
    x, y = choice.taken.method.parts
    assert x * y >= 8
    assert "nor do the factors of its substructures" in choose_method(large, memory=GIGABYTE).why


@pytest.mark.parametrize("size", [LAP, LONG])
def test_the_choice_states_the_cost_of_the_others(size):
    lines = choose_method(size, memory=10.0 * GIGABYTE).explain()
    assert "Newton's method on the whole needs" in lines
    assert "LATIN needs" in lines


def test_bodies_of_a_million_unknowns_are_solved_by_multigrid():
    choice = choose_method(JointSize(1_000_000, 4000, 2, 2), memory=10.0 * GIGABYTE)
    assert choice.taken.method == MultigridNewton()
    assert choice.taken.memory < 9.0 * GIGABYTE
    assert "do not fit" in choice.why
    faster = choose_method(JointSize(100_000, 4000, 2, 1), memory=80.0 * GIGABYTE)
    assert faster.taken.method == MultigridNewton()
    assert "less than half the time" in faster.why

"""An error that cannot be computed is reported as unknown wherever it is printed."""

import numpy as np
import pytest

from multiscale.pipeline.showing import (
    View,
    format_error,
    format_interval,
    format_sides,
    list_cycles,
    round_by,
    tabulate_budget,
    tabulate_sensitivity,
)
from multiscale.pipeline.stages.braking import braking_answer
from multiscale.pipeline.stages.joint import JOINT_TABLE
from multiscale.schema import MACRO_RESULT
from multiscale.upscaling import with_budget, with_intervals
from multiscale.upscaling.budget import ALWAYS, ERROR_TERMS, Term, assemble_budget


def test_a_total_is_a_percentage_or_unknown():
    assert format_error(0.0123) == "1.2"
    assert format_error(float("nan")) == "unknown"


def joint(total):
    unit = np.ones(1)
    values = {
        "joint_stiffness": 1e13 * unit,
        "mean_gap": 1e-6 * unit,
        "contact_fraction": 0.1 * unit,
    }
    values |= {"preload": 1e7 * unit, "converged": np.ones(1, dtype=int)}
    values |= {"residual": 0.0 * unit, "wall_time": unit}
    budget = {"error_total": [[total]], "error_half_width": [[[total]]], "error_bias": [[[0.0]]]}
    result = MACRO_RESULT.build(values | budget)
    return result.assign_coords(quantity=["joint_stiffness"])


@pytest.mark.parametrize(("total", "sentence"), [(0.0123, "1.2"), (np.nan, "unknown")])
def test_the_table_of_a_joint_states_an_unknown_error(total, sentence):
    head, rows = JOINT_TABLE.rows(joint(total))
    assert dict(zip(head, rows[0], strict=True))["error (%)"] == sentence


def test_answers_of_cycles_have_an_interval_at_the_last_cycle():
    cycles = joint(0.1).assign(cycle_energy=("cycle", [3.0, 2.0]))
    ends = with_intervals(cycles.assign_coords(quantity=["cycle_energy"]))
    np.testing.assert_allclose(ends["cycle_energy_mean_law"][:, 1], [1.8, 2.2])
    assert np.isnan(ends["cycle_energy_mean_law"][:, 0]).all()


@pytest.mark.parametrize(("total", "sentence"), [(0.0123, " ± 1.2 %"), (np.nan, ", error unknown")])
def test_the_parts_of_a_joint_state_an_unknown_error(total, sentence):
    result = joint(total).assign(interface_stiffness=("step", [2e13]))
    head, rows = JOINT_TABLE.rows(result.assign_coords(quantity=["interface_stiffness"]))
    (column,) = (k for k, name in enumerate(head) if name.startswith("interface"))
    assert rows[0][column] == f"20{sentence}"


@pytest.mark.parametrize(
    ("total", "sentence"), [(0.0123, "± 1.2 %"), (np.nan, "± an unknown error")]
)
def test_the_answer_of_a_tread_block_states_an_unknown_error(total, sentence):
    result = joint(total).assign(
        temperature=("step", [293.15]),
        sliding_speed=("step", [1.0]),
        braking_force=("step", [50.0]),
        braking_coefficient=("step", [0.5]),
        quantity=["braking_force"],
    )
    assert sentence in next(braking_answer(result))


@pytest.mark.parametrize(("converged", "sentence"), [(1, "unknown"), (0, "not closed")])
def test_a_cycle_without_a_loss_states_why(converged, sentence):
    result = joint(0.01).assign(converged=("step", [converged]), cycle_energy=("cycle", [np.nan]))
    assert list_cycles(result) == [f"cycle 0: {sentence}"]


def say(result, form):
    """Joint stiffness at the only step."""
    return View(result).phrase(result.isel(step=0), "joint_stiffness", form)


def budgeted(half_widths, uncertain=1.0):
    """A joint of 23 MPa/µm with a share of the interface in its compliance, with some terms."""
    known = dict.fromkeys(ALWAYS, 0.0) | half_widths
    terms = {
        term: Term(
            "as measured" if known.get(term, 0.0) is not None else "not known: measure it",
            None if known.get(term) is None else np.full((2, 1), known[term]),
        )
        for term in ERROR_TERMS
    }
    for term in set(ERROR_TERMS) - known.keys():
        terms[term] = Term("not in a law")
    names = ("interface_stiffness", "joint_stiffness")
    budget = assemble_budget(terms, names, None, steps=1)
    half = budget["error_half_width"].copy()
    half[1] *= uncertain
    total = budget["error_total"].copy()
    total[1] *= uncertain
    result = joint(0.0).drop_dims(["quantity", "error_term"])
    stiffness = {"joint_stiffness": 23e12, "interface_stiffness": 23e12 / uncertain}
    result = MACRO_RESULT.assign(result, {name: [value] for name, value in stiffness.items()})
    budget = budget.assign(error_half_width=half, error_total=total)
    return with_intervals(with_budget(result, budget))


def test_the_error_follows_an_interval_that_ends_at_zero():
    """An interface that may carry nothing, in series with stiff bodies: 23, 0 ... 24."""
    result = budgeted({"sampling": 1.36}, uncertain=0.05)
    head, rows = JOINT_TABLE.rows(result)
    row = dict(zip(head, rows[0], strict=True))
    assert row["one part, 95 %"] == "0 ... 24"
    assert row["error (%)"] == "-100, +3"
    assert row["interface (MPa/µm)"] == "460 (-100, +136 %)"
    assert say(result, "±") == "23 MPa/µm (-100, +3 %)"
    lines = {line[0]: line[1] for line in tabulate_budget(result, "joint_stiffness")[1]}
    assert (lines["total"], lines["interval"]) == ("6.8", "-100, +3")


def test_the_error_is_the_larger_side_of_an_interval_about_as_wide_on_both():
    assert format_sides(100.0, np.array([94.0, 105.0])) == "6"
    assert format_sides(100.0, np.array([97.9, 105.0])) == "-2.1, +5"


@pytest.mark.parametrize("missing", ["sampling", "cell size"])
def test_known_terms_are_a_lower_bound_next_to_the_name_of_the_unknown_term(missing):
    """Whether the total must hold the term or not."""
    result = budgeted({"fit": 0.03, "increments": 0.04, missing: None})
    head, rows = JOINT_TABLE.rows(result)
    row = dict(zip(head, rows[0], strict=True))
    assert row["error (%)"] == "5 + ?"
    assert row["one part, 95 %"] == "21.8 ... 24.1 + ?"
    assert row["interface (MPa/µm)"] == "23.0 ± 5 % + ?"
    assert say(result, "±") == "23.0 MPa/µm ± 5 % or more"
    assert say(result, "()") == (
        f"23.0 MPa/µm (mean law and one part 21.8 ... 24.1; or wider: {missing} not known)"
    )
    *_, total = tabulate_budget(result)[1]
    assert total[:2] == ("total", "5 + ?")
    assert total[-1].endswith(f"lower bounds, without unknown terms: {missing}")


def test_an_answer_without_any_known_term_has_no_number_for_its_error():
    result = budgeted({"macro discretisation": None})
    head, rows = JOINT_TABLE.rows(result)
    assert dict(zip(head, rows[0], strict=True))["error (%)"] == "unknown"
    assert say(result, "()") == "23 MPa/µm (error unknown: macro discretisation)"


def test_digits_do_not_exceed_the_error():
    bound = " + ?"
    assert format_interval(445.9496, np.array([445.9462, 445.9529])) == "± < 0.001 %"
    assert format_interval(445.9496, np.array([445.85, 446.05]), bound) == "± 0.022 % + ?"
    assert format_interval(445.9496, np.array([441.0, 451.0])) == "441 ... 451"
    assert format_interval(0.3431, 0.3431 + np.array([-3.3e-16, 3.3e-16])) == ""
    assert format_interval(0.3431, 0.3431 + np.array([-3.3e-16, 3.3e-16]), bound) == "unknown"
    assert round_by(445.9496, 0.0034) == "445.9"
    wide = joint(0.5).assign(
        joint_stiffness=("step", [2.4e11]),
        joint_stiffness_mean_law=(("step", "bound"), [[0.0, 9e12]]),
    )
    assert View(wide).text(wide.isel(step=0), "joint_stiffness") == "0.24"  # not 0
    unsure = budgeted({"fit": 1e-4, "macro discretisation": None})
    assert say(unsure, "±") == "23 MPa/µm ± 0.01 % or more"


def test_rows_without_a_part_in_the_budget_share_a_row():
    rows = tabulate_budget(budgeted({"fit": 0.03, "cell size": None}))[1]
    assert [row[0] for row in rows] == ["fit", "cell size", "all others", "total"]
    assert rows[2][-1].startswith(
        "contribute nothing: sampling, increments, surface; do not apply: micro"
    )


def test_parameters_that_change_nothing_have_no_row():
    changes = {"sensitivity": (("parameter", "quantity", "step"), [[[0.02]], [[4e-14]], [[5e-4]]])}
    result = joint(0.01).assign(changes).assign_coords(error_term=["sampling"])
    result = result.assign_coords(parameter=["first", "second", "third"])
    assert [row[0] for row in tabulate_sensitivity(result)[1]] == ["first"]

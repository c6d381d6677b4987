"""An error that cannot be computed is said to be unknown wherever it is printed."""

import numpy as np
import pytest

from multiscale.pipeline.rows import list_cycles, say_error, tabulate
from multiscale.pipeline.stages.braking import braking_answer
from multiscale.schema import MACRO_RESULT


def test_a_total_is_a_percentage_or_unknown():
    assert say_error(0.0123) == "1.2"
    assert say_error(float("nan")) == "unknown"


def joint(total):
    one = np.ones(1)
    values = {"joint_stiffness": 1e13 * one, "mean_gap": 1e-6 * one, "contact_fraction": 0.1 * one}
    values |= {"preload": 1e7 * one, "converged": np.ones(1, dtype=int)}
    values |= {"residual": 0.0 * one, "wall_time": one}
    budget = {"error_total": [[total]], "error_half_width": [[[total]]], "error_bias": [[[0.0]]]}
    result = MACRO_RESULT.build(values | budget)
    return result.assign_coords(quantity=["joint_stiffness"])


@pytest.mark.parametrize(("total", "said"), [(0.0123, "1.2"), (np.nan, "unknown")])
def test_the_table_of_a_joint_says_so(total, said):
    head, rows = tabulate(joint(total))
    assert dict(zip(head, rows[0], strict=True))["error (%)"] == said


@pytest.mark.parametrize(("total", "said"), [(0.0123, " ± 1.2 %"), (np.nan, ", error unknown")])
def test_the_parts_of_a_joint_say_so(total, said):
    result = joint(total).assign(interface_stiffness=("step", [2e13]))
    head, rows = tabulate(result.assign_coords(quantity=["interface_stiffness"]))
    (column,) = (k for k, name in enumerate(head) if name.startswith("interface"))
    assert rows[0][column] == f"20{said}"


@pytest.mark.parametrize(("total", "said"), [(0.0123, "± 1.2 %"), (np.nan, "± an unknown error")])
def test_the_answer_of_a_tread_block_says_so(total, said):
    result = joint(total).assign(
        temperature=("step", [293.15]),
        sliding_speed=("step", [1.0]),
        braking_force=("step", [50.0]),
        braking_coefficient=("step", [0.5]),
    )
    assert said in braking_answer(result)[0]


@pytest.mark.parametrize(("converged", "said"), [(1, "unknown"), (0, "not closed")])
def test_a_cycle_without_a_loss_says_why(converged, said):
    result = joint(0.01).assign(converged=("step", [converged]), cycle_energy=("cycle", [np.nan]))
    assert list_cycles(result) == [f"cycle 0: {said}"]

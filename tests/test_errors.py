"""Ranges of numbers: ends belong to an interval as its brackets state, and NaN never does."""

import math

import numpy as np
import pytest

from multiscale.errors import CaseError, require


@pytest.mark.parametrize(
    ("interval", "inside", "outside", "words"),
    [
        ("(0, inf)", (1e-300, 1e300), (0.0, -1.0), "be positive"),
        ("(0, inf]", (math.inf,), (0.0,), "be positive"),
        ("[0, inf)", (0.0,), (-1e-300,), "not be negative"),
        ("[1, inf)", (1, 2), (0, 0.999), "be at least 1"),
        ("(1, inf)", (1.001,), (0.0, 1.0), "be above 1"),
        ("[0, 1]", (0.0, 1.0), (-0.1, 1.1), "lie from 0 to 1"),
        ("[0, 1)", (0.0,), (1.0,), "lie from 0 to below 1"),
        ("(0, 1]", (1.0,), (0.0,), "lie above 0 and up to 1"),
        ("(-1, 0.5)", (0.0,), (-1.0, 0.5), "lie between -1 and 0.5"),
    ],
)
def test_numbers_outside_their_interval_are_refused(interval, inside, outside, words):
    for value in inside:
        require("share", value, interval)
    for value in (*outside, math.nan):
        with pytest.raises(CaseError, match=rf"^share must {words} \(Pa\), got {value:g}$"):
            require("share", value, interval, "Pa")


def test_a_number_that_counts_is_an_integer():
    for count in (3, np.int64(3)):
        require("count", count, "[1, inf)", integer=True)
    for count in (1.5, 3.0):
        with pytest.raises(CaseError, match=f"^count must be an integer, got {count}$"):
            require("count", count, "[1, inf)", integer=True)


@pytest.mark.parametrize("interval", ["(0, inf)", "[0, inf)", "[1, inf)"])
def test_an_infinite_number_is_refused_as_such(interval):
    with pytest.raises(CaseError, match=r"^share must be finite, got inf$"):
        require("share", math.inf, interval)

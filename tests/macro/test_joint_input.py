"""Blocks and joints that cannot be are refused with what was found."""

import pytest

from multiscale.errors import CaseError
from multiscale.macro import Block, RoughJoint

SOUND = {"height": 5e-3, "youngs_modulus": 210e9, "poissons_ratio": 0.3}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"height": 0.0}, r"height of a block must be positive \(m\), got 0"),
        ({"youngs_modulus": -1.0}, r"youngs_modulus of a block must be positive \(Pa\), got -1"),
        ({"poissons_ratio": 0.5}, "poissons_ratio of a block must lie between -1 and 0.5, got 0.5"),
        ({"layers": 0}, "a block needs at least one layer of elements, got 0"),
    ],
)
def test_a_block_that_cannot_be_is_refused(given, message):
    with pytest.raises(CaseError, match=message):
        Block(**SOUND | given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"section": (0.01, 0.0)}, "section must have positive lengths"),
        ({"elements": (0, 4)}, r"elements must be at least one along x and y, got \(0, 4\)"),
        ({"quadrature_order": 0}, "quadrature_order must be at least 1, got 0"),
        ({"eccentricity": (0.0, 0.006)}, r"\|eccentricity\| < 0.005 m, got 0.006"),
    ],
)
def test_a_joint_that_cannot_be_is_refused(given, message):
    block = Block(**SOUND)
    with pytest.raises(CaseError, match=message):
        RoughJoint(**{"section": (0.01, 0.01), "lower": block, "upper": block} | given)

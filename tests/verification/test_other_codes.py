"""The egg box between z = s (1 + .02 cos cos) and a rigid flat, as other codes solve it.

Forces on the unit cell for E = 1, nu = .3 and 32 x 32 x 12 hexahedra: GetFEM 5.4 (augmented
Lagrangian) and Kratos 10.4 (mortar), on planes at s = 1 - (1 - k/12)^1.6.
"""

import numpy as np
import pytest

from multiscale.micro import Cell, Path, solve_cell
from tests.support import egg_box

APPROACH = (0.01, 0.02, 0.03, 0.04)
GETFEM = np.array([0.0034032, 0.0099604, 0.0188673, 0.0298317])
KRATOS = np.array([0.0033933, 0.0099955, 0.0188608, 0.0298244])


def forces(n, layers):
    cell = Cell(egg_box(n, 0.02), 1.0, layers, youngs_modulus=1.0, poissons_ratio=0.3)
    response = solve_cell(cell, Path(approach=APPROACH), recover_stress=False)
    assert response["converged"].values.all()
    return -response["traction"].values[0, :, 0]


@pytest.mark.parametrize("code", [GETFEM, KRATOS], ids=["GetFEM", "Kratos"])
def test_forces_are_those_of_other_finite_element_codes(code):
    np.testing.assert_allclose(forces(32, 12), code, rtol=1e-2)


def test_forces_converge_with_the_grid():
    coarse, middle, fine = forces(24, 10), forces(48, 14), forces(96, 20)
    assert np.all(np.abs(fine - middle) < 0.5 * np.abs(middle - coarse))
    np.testing.assert_allclose(forces(32, 12), fine, rtol=2e-2)

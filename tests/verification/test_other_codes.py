"""The egg box between z = s (1 + .02 cos cos) and a rigid flat, as other codes solve it.

Forces on the unit cell for E = 1, nu = .3 on n x n x m hexahedra, with planes at
s = 1 - (1 - k/m)^1.6. Small strain, n = 32, m = 12: GetFEM 5.4 (augmented Lagrangian) and
Kratos 10.4 (mortar).

Large strain: GetFEM 5.4 on one quarter of the cell, trilinear hexahedra, the weak form of the same
energies written in its form language and differentiated by it, constant dilatation in the elements
of metal, Newton residual below 1e-9, contact by an augmented Lagrangian multiplier, integrated over
the surface or lumped at its nodes. CalculiX 2.20 (NLGEOM, C3D8, node-to-surface contact with a
penalty of 5e3) has other volume energies: K/2 (J - 1)^2 next to mu/2 (J^-2/3 |F|^2 - 3) for rubber,
K/2 ((J^2 - 1)/2 - ln J) for metal. Metal yields at 1/200, hardens by .01, and is pressed in 40
equal increments.
"""

import numpy as np
import pytest

from multiscale.laws.bulk import J2, NeoHookean
from multiscale.micro import Cell, Path, layer, solve_cell
from tests.support import egg_box

APPROACH = (0.01, 0.02, 0.03, 0.04)
GETFEM = np.array([0.0034032, 0.0099604, 0.0188673, 0.0298317])
KRATOS = np.array([0.0033933, 0.0099955, 0.0188608, 0.0298244])

RUBBER, METAL = NeoHookean(1.0, 0.3), J2(1.0, 0.3, 1.0 / 200.0, 0.01)
NODAL_RUBBER = np.array([0.0032196889, 0.0098282757, 0.019033228, 0.030304025])  # n = 16, m = 8
NODAL_METAL = np.array([0.0019290784, 0.0053974345, 0.01226607, 0.020316292])
GETFEM_RUBBER = np.array([0.0033973775, 0.0099662031, 0.019007485, 0.030357718])  # n = 32, m = 12
GETFEM_METAL = np.array([0.0019250064, 0.0057965931, 0.012076779, 0.020323031])
CALCULIX_RUBBER = np.array([0.0033767196, 0.0099424400, 0.018851008, 0.030047584])
CALCULIX_METAL = np.array([0.0019342352, 0.0057784800, 0.011890236, 0.019885588])
OTHER_VOLUME = 0.019963844 / 0.020316292
"""The last force on metal with the volume energy of CalculiX: GetFEM, n = 16, at nodes."""


def forces(n, layers, bulk=None):
    cell = Cell(egg_box(n, 0.02), 1.0, layers, 1.0, 0.3, bulk=bulk)
    response = solve_cell(cell, Path(approach=APPROACH))
    assert response["converged"].values.all()
    if bulk is METAL:
        np.testing.assert_array_equal(response["increments"], 10.0)
    return -response["traction"].values[0, :, 0]


@pytest.fixture
def same_layers(monkeypatch):
    """Place the layers as in the other codes."""
    monkeypatch.setattr(
        layer,
        "graded_planes",
        lambda depth, layers, _: depth * (1.0 - (1.0 - np.arange(layers + 1) / layers) ** 1.6),
    )


@pytest.mark.parametrize("code", [GETFEM, KRATOS], ids=["GetFEM", "Kratos"])
def test_forces_equal_other_finite_element_codes(code):
    np.testing.assert_allclose(forces(32, 12), code, rtol=1e-2)


def test_forces_converge_with_the_grid():
    coarse, middle, fine = forces(24, 10), forces(48, 14), forces(96, 20)
    assert np.all(np.abs(fine - middle) < 0.5 * np.abs(middle - coarse))
    np.testing.assert_allclose(forces(32, 12), fine, rtol=2e-2)


@pytest.mark.usefixtures("same_layers")
@pytest.mark.parametrize(
    ("bulk", "expected"),
    [
        pytest.param(RUBBER, NODAL_RUBBER, id="rubber"),
        pytest.param(METAL, NODAL_METAL, id="metal", marks=pytest.mark.slow),
    ],
)
def test_on_the_same_mesh_with_contact_at_nodes_getfem_finds_the_same_forces(bulk, expected):
    np.testing.assert_allclose(forces(16, 8, bulk), expected, rtol=1e-6)


def test_rubber_presses_as_in_getfem_and_calculix():
    force = forces(32, 12, RUBBER)
    np.testing.assert_allclose(force, GETFEM_RUBBER, rtol=5e-3)
    np.testing.assert_allclose(force, CALCULIX_RUBBER, rtol=2e-2)


@pytest.mark.slow
def test_metal_presses_as_in_getfem_and_calculix():
    force = forces(32, 12, METAL)
    np.testing.assert_allclose(force, GETFEM_METAL, rtol=1e-2)
    # the block as a whole is compressed in the last step, where the volume energies part
    np.testing.assert_allclose(force[:3], CALCULIX_METAL[:3], rtol=2e-2)
    assert force[3] * OTHER_VOLUME == pytest.approx(CALCULIX_METAL[3], rel=1e-2)

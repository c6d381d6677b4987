"""The exact compliance of layers, against a closed form and against finite elements."""

import numpy as np
import pytest

from multiscale.laws.bulk.bulk_law import lame_parameters
from multiscale.micro.elastic.compliance import layered_compliance
from multiscale.micro.elastic.lateral_fft import factorise_flat_cell
from tests.closed_forms import layer

SIZE = (1.0, 0.7)


def wavenumbers(nx, ny):
    return 2.0 * np.pi * np.hypot(np.fft.fftfreq(nx, 1 / nx)[:, None], np.arange(ny // 2 + 1) / 0.7)


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.4999])
@pytest.mark.parametrize("depth", [0.01, 0.25, 100.0], ids=["film", "layer", "half-space"])
def test_one_layer_is_the_closed_form(nu, depth):
    lame, shear = lame_parameters(np.ones(1), nu)
    compliance = layered_compliance((16, 12), SIZE, np.array([0.0, depth]), lame, shear)
    q = wavenumbers(16, 12)
    assert compliance[0, 0] == pytest.approx(layer.oedometer_compliance(depth, 1.0, nu))
    q[0, 0] = 1.0
    expected = 2.0 * (1.0 - nu**2) / q * layer.ratio_bonded(q * depth, nu)
    # a film's waves are nearly dependent: (q h)^-3 times rounding
    np.testing.assert_allclose(compliance.flat[1:], expected.flat[1:], rtol=1e-9)


def test_cutting_a_layer_in_two_changes_nothing():
    lame, shear = np.array([1.0, 1.0 + 1e-14, 2.0]), np.array([0.5, 0.5, 3.0])
    whole = layered_compliance((8, 8), SIZE, np.array([0.0, 0.5, 0.6]), lame[1:], shear[1:])
    cut = layered_compliance((8, 8), SIZE, np.array([0.0, 0.2, 0.5, 0.6]), lame, shear)
    np.testing.assert_allclose(cut, whole, rtol=1e-10)


@pytest.mark.parametrize("contrast", [1e-2, 1e2, 1e4])
def test_finite_elements_of_a_layered_cell_converge_to_it_at_second_order(contrast):
    modulus = np.array([1.0, contrast, 0.5])
    errors = []
    for refinement in (16, 32):
        planes = np.linspace(0.0, 0.6, 3 * refinement + 1)
        lame, shear = lame_parameters(np.repeat(modulus, refinement), 0.3)
        n = 6 * refinement
        result = factorise_flat_cell((n, 1), (1.0 / n, 1.0), planes, lame, shear)
        exact = layered_compliance((n, 1), (1.0, 1.0), planes, lame, shear)
        errors.append(result.surface_compliance[5][1:3, 0] / n / exact[1:3, 0] - 1.0)
    assert np.all(np.abs(errors[1]) < 1e-3)
    np.testing.assert_allclose(np.log2(np.abs(errors[0] / errors[1])), 2.0, atol=0.05)

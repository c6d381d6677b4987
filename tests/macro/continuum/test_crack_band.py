"""Bodies that crack in bands of elements: energy whatever the mesh, and strength against size."""

import numpy as np
import pytest
from skfem import MeshQuad

from multiscale.fe.mesh_file import box_mesh
from multiscale.laws import Softening
from multiscale.laws.bulk import Elastic
from multiscale.macro import Body
from multiscale.macro.continuum import follow_crack_band
from multiscale.schema import CRACK_BAND

E, NU = 30e9, 0.2
OPENING = np.linspace(0.0, 1e-4, 30)
LAW = Softening(OPENING, 3e6 * (1.0 - OPENING / OPENING[-1]) ** 2)


def plate(length, height, elements, *, notch=0.0, poissons_ratio=NU):
    """A plate pulled along x, with a notch of no stiffness from the bottom in its middle column."""
    columns, rows = elements
    mesh = MeshQuad.init_tensor(
        np.linspace(0.0, length, columns + 1), np.linspace(0.0, height, rows + 1)
    )
    middle = mesh.p[:, mesh.t].mean(axis=1)
    cut = (np.abs(middle[0] - 0.5 * length) < 0.5 * length / columns) & (middle[1] < notch)
    mesh = mesh.remove_elements(np.flatnonzero(cut)) if cut.any() else mesh
    tiny = 1e-9
    mesh = mesh.with_boundaries(
        {
            "left": lambda x: x[0] < tiny,
            "right": lambda x: x[0] > length - tiny,
            "bottom": lambda x: x[1] < tiny,
        }
    )
    supports = {"left": (0.0, None)}
    pins = {(0.0, height): (None, 0.0)}
    return Body(mesh, Elastic(E, poissons_ratio), supports, {"right": (1e6, 0.0)}, pins=pins)


def test_the_energy_of_a_crack_does_not_depend_on_the_mesh():
    energies = []
    for columns in (5, 11, 23):
        result = follow_crack_band(plate(0.2, 0.02, (columns, 1)), LAW)
        CRACK_BAND.check(result)
        assert int(result["converged"]) == 1
        assert np.count_nonzero(result["stiffness_share"].values < 1.0) == 1
        energies.append(float(result["dissipation"][-1]) / 0.02)
        assert float(result["factor"].max()) * 1e6 == pytest.approx(LAW.strength, rel=1e-6)
    np.testing.assert_allclose(energies, LAW.fracture_energy, rtol=0.03)


def test_an_even_bar_has_the_energy_of_its_teeth_on_every_mesh():
    """Without Poisson's ratio there is no contraction that neighbours could hold back."""
    energies = [
        float(
            follow_crack_band(plate(0.2, 0.02, (n, 1), poissons_ratio=0.0), LAW)["dissipation"][-1]
        )
        for n in (5, 23)
    ]
    assert energies[0] == pytest.approx(energies[1], rel=1e-8)
    assert energies[0] / 0.02 == pytest.approx(LAW.fracture_energy, rel=3e-3)


def test_a_bar_of_hexahedra_has_the_same_energy():
    mesh = box_mesh((0.2, 0.02, 0.03), (5, 1, 1))
    supports = {"left": (0.0, None, None), "front": (None, 0.0, None), "bottom": (None, None, 0.0)}
    body = Body(mesh, Elastic(E, 0.0), supports, {"right": (1e6, 0.0, 0.0)})
    energy = float(follow_crack_band(body, LAW)["dissipation"][-1]) / (0.02 * 0.03)
    assert energy == pytest.approx(LAW.fracture_energy, rel=3e-3)


@pytest.mark.slow
def test_strength_falls_with_size_as_bazants_law():
    """Z. P. Bazant, J. Eng. Mech. 110 (1984) 518: strength^-2 of notches is linear in size."""
    brittle, sizes = Softening(0.05 * OPENING, LAW.stress), np.array([8, 16, 32])
    strength = []
    for n in sizes:
        size = 5e-3 * n
        body = plate(2.0 * size, size, (2 * n + 1, n), notch=0.25 * size)
        result = follow_crack_band(body, brittle, teeth=10, stop=0.7)
        strength.append(1e6 * float(result["factor"].max()))
    y = 1.0 / np.array(strength) ** 2
    slope, start = np.polyfit(sizes, y, 1)
    np.testing.assert_allclose(start + slope * sizes, y, rtol=0.01)
    local = np.diff(np.log(strength)) / np.diff(np.log(sizes))
    middle = np.sqrt(sizes[1:] * sizes[:-1])
    np.testing.assert_allclose(local, -0.5 * middle / (middle + start / slope), atol=0.02)
    assert local[1] < -0.35  # on the way to -1/2 of linear fracture mechanics

"""Small vibration of links: strings, beams under tension, buckling and mechanisms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from xarray import Dataset

from multiscale.laws.link import Bar, Beam, Cable
from multiscale.macro import LinkSystem
from multiscale.macro.links import natural_frequencies
from tests.support import observed_rate

LENGTH, BENDING, MASS = 3.0, 700.0, 2.5  # m, N m², kg/m


def row(n, law, tension):
    """A row of n links along x between two hinges, which moves along z."""
    components = 6 if isinstance(law, Beam) else 3
    fixed = np.zeros((n + 1, components), dtype=bool)
    fixed[[0, n], :3] = fixed[:, :2] = True
    fixed[:, 3::2] = True
    position = np.column_stack([np.linspace(0.0, LENGTH, n + 1), np.zeros((n + 1, 2))])
    ends = np.column_stack([np.arange(n), np.arange(1, n + 1)])
    still = np.zeros((n + 1, components))
    return LinkSystem(
        position, ends, (law,), np.zeros(n, int), fixed, still, np.full(n, float(tension))
    )


def at_prestress(system):
    """The state of prestress, which has no elastic stiffness across a row of cables or bars."""
    values = {"tension": system.prestress, "slack": 0.0 * system.prestress}
    steps = {name: (("step", "link"), value[None]) for name, value in values.items()}
    return Dataset({**steps, "converged": ("step", [1])})


def frequencies(system, **options):
    mass = MASS * LENGTH / system.n_links
    moving = natural_frequencies(system, at_prestress(system), mass, **options)
    return moving["natural_frequency"].values[0]


@pytest.mark.parametrize("tension", [-0.9, 0.0, 5.0])
def test_a_beam_under_tension_has_its_closed_form(tension):
    """omega^2 = (j pi / L)^4 EI / m (1 + N L^2 / (j^2 pi^2 EI)), below the buckling load too."""
    wave = np.arange(1, 4) * np.pi / LENGTH
    force = tension * BENDING * wave[0] ** 2
    exact = np.sqrt(wave**4 * BENDING / MASS * (1.0 + force / (BENDING * wave**2))) / (2.0 * np.pi)
    beam, counts = Beam(1e9, 1e6, BENDING, BENDING), np.array([16, 32, 64])
    errors = [np.abs(frequencies(row(n, beam, force), count=3) / exact - 1.0) for n in counts]
    assert np.all(errors[-1] < 2e-3)
    assert observed_rate(1.0 / counts, [error[2] for error in errors]) > 1.9


@pytest.mark.parametrize("radius", [0.05, 0.3])
def test_rotary_inertia_gives_the_closed_form_of_a_rayleigh_beam(radius):
    """omega^2 = EI k^4 / (m (1 + r^2 k^2)) between two hinges, r^2 = EI / EA."""
    wave = np.arange(1, 4) * np.pi / LENGTH
    inertia = MASS * (1.0 + (radius * wave) ** 2)
    exact = wave**2 * np.sqrt(BENDING / inertia) / (2.0 * np.pi)
    beam = Beam(BENDING / radius**2, 1e6, BENDING, 2.0 * BENDING)
    coarse, middle, fine = (frequencies(row(n, beam, 0.0), count=3) for n in (16, 32, 64))
    # the ends turn with the mass of a whole beam, an error of first order
    assert np.all(np.abs(fine / exact - 1.0) < 0.01)
    np.testing.assert_allclose((middle - coarse) / (fine - middle), 2.0, rtol=0.2)
    np.testing.assert_allclose(2.0 * fine - middle, exact, rtol=6e-4)


def cantilever(turn, n=32):
    """A straight beam along the first axis of a rotation, clamped at one end."""
    fixed = np.zeros((n + 1, 6), dtype=bool)
    fixed[0] = True
    ends = np.column_stack([np.arange(n), np.arange(1, n + 1)])
    position = np.linspace(0.0, LENGTH, n + 1)[:, None] * turn[:, 0]
    beam = Beam(2e4, 60.0, BENDING, 2.0 * BENDING, up=tuple(turn[:, 2]))
    return LinkSystem(position, ends, (beam,), np.zeros(n, int), fixed, np.zeros((n + 1, 6)))


def test_a_shaft_has_the_inertia_of_both_bendings_and_any_direction():
    """Twist of a clamped shaft: omega = pi / (2 L) sqrt(GJ / (m (r_y^2 + r_z^2)))."""
    reach = LENGTH * (1.0 + 0.5 / 32)  # the last node has the mass of a whole beam
    shaft = np.sqrt(60.0 / (MASS * 3.0 * BENDING / 2e4)) / (4.0 * reach)
    turn = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()
    straight, turned = (frequencies(cantilever(axes), count=8) for axes in (np.eye(3), turn))
    assert np.min(np.abs(straight / shaft - 1.0)) < 2e-4
    np.testing.assert_allclose(turned, straight, rtol=1e-8)


def test_a_string_has_its_closed_form():
    """n links: omega = 2 sqrt(N / (m h^2)) sin(j pi / 2 n); slack links have no stiffness."""
    n, force, j = 20, 400.0, np.arange(1, 4)
    h = LENGTH / n
    exact = 2.0 * np.sqrt(force / (MASS * h**2)) * np.sin(j * np.pi / (2 * n)) / (2.0 * np.pi)
    np.testing.assert_allclose(frequencies(row(n, Cable(1e6), force), count=3), exact, rtol=1e-8)


@pytest.mark.parametrize(
    "system",
    [
        row(32, Beam(1e9, 1e6, BENDING, BENDING), -1.05 * BENDING * (np.pi / LENGTH) ** 2),
        row(8, Bar(1e6), -1.0),
    ],
    ids=["beyond the buckling load", "bars under compression"],
)
def test_an_unstable_structure_has_no_frequencies(system):
    moving = natural_frequencies(system, at_prestress(system), 1.0)
    assert np.isnan(moving["natural_frequency"].values).all()
    assert np.isnan(moving["first_frequency"].values).all()

"""Figures of damage: the data in the axes equal the datasets."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from multiscale.micro.damage import (
    FatigueMaterial,
    max_damage,
    voxelise,
    woehler_curve,
)
from multiscale.plotting import (
    plot_damage_sphere,
    plot_woehler,
    plot_worst_section,
)
from tests.micro.damage.solid import channels

RVE = channels([(5e-4, 5e-4, 5e-4)], [3e-4], (1e-3, 1e-3, 1e-3))


@pytest.fixture(scope="module")
def sections():
    return max_damage(RVE, level=0, sections=5)


@pytest.fixture(scope="module")
def curve():
    material = FatigueMaterial(200e9, 0.3, 200e6, 0.5e6, threshold=0.05)
    return woehler_curve(material, np.array([150e6, 210e6, 250e6]))


def axes(**options):
    return Figure().add_subplot(**options)


def test_the_sphere_has_a_face_for_every_three_normals(sections):
    ax = plot_damage_sphere(sections, ax=axes(projection="3d"))
    sphere = ax.collections[0]
    assert len(sphere.get_facecolor()) == 2 * (2 * sections.sizes["direction"]) - 4
    assert "damage" in ax.figure.axes[1].get_ylabel()


def test_the_worst_section_shows_its_share_of_void(sections):
    ax = plot_worst_section(RVE, sections, ax=axes())
    values = ax.images[0].get_array()
    share = np.nanmean(np.ma.filled(values.astype(float), np.nan))
    assert share == pytest.approx(float(sections["maximum_damage"]), abs=0.01)
    assert "mm" in ax.get_xlabel()
    image = plot_worst_section(voxelise(RVE, 64), sections, ax=axes()).images[0].get_array()
    share = np.nanmean(np.ma.filled(image.astype(float), np.nan))
    assert share == pytest.approx(float(sections["maximum_damage"]), abs=0.03)


def test_lives_are_in_cycles_and_megapascal(curve):
    ax = plot_woehler(curve, ax=axes())
    rupture, onset, endless = ax.lines
    np.testing.assert_allclose(rupture.get_ydata(), [210.0, 250.0])
    np.testing.assert_allclose(rupture.get_xdata(), curve["cycles_to_rupture"][1:])
    assert np.all(onset.get_xdata() < rupture.get_xdata())
    np.testing.assert_allclose(endless.get_ydata(), [150.0])

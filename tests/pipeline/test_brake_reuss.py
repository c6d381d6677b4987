"""The Brake-Reuss beam against the published frequencies of its preloaded modes."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.sparse.linalg import eigsh

from multiscale.io import open_dataset
from multiscale.macro.substructures.cut import cut_assembly
from multiscale.macro.substructures.whole import assemble
from multiscale.macro.vibration import Amplitudes, follow_backbone, structure_mass
from multiscale.pipeline import load_case
from multiscale.pipeline.body_sources import BodiesWithLaws, Change
from multiscale.pipeline.stages.vibrating_bodies import _laws, _press
from multiscale.plotting.vibration_figures import plot_vibrating_joint


def test_the_shipped_beam_has_its_asperities_and_modes():
    case = load_case("brake_reuss")
    (law,) = _laws(BodiesWithLaws(case.structure, case, [None]), Change())
    assert law.asperities.density.sum() == pytest.approx(1371333.5)
    # by the reference implementation for the whole table of heights
    response = law.respond(np.array([[-1.5e-5], [0.0], [0.0]]), np.zeros((law.n_state, 1)))
    assert -response.traction[0, 0] == pytest.approx(15.079e6, rel=0.01)


@pytest.mark.slow
def test_a_quick_run_softens_and_damps_as_the_reference(shipped_run):
    """At the largest amplitude, less their values at the least: 7.02 % and 2.98 % there.

    Elements of first order are stiff in bending; the full model keeps the tolerances below.
    """
    dataset = open_dataset(shipped_run("brake_reuss")[0] / "vibration.nc")
    assert dataset.sizes["node"] < 5000  # elements of first order
    softer = 1.0 - dataset["frequency"].values[-1] / dataset["frequency"].values[0]
    assert softer == pytest.approx(0.0702, rel=0.08)
    assert np.ptp(dataset["damping"].values) == pytest.approx(0.0298, rel=0.15)
    seen = plot_vibrating_joint(dataset, ax=Figure().add_subplot()).get_xlim()
    assert np.ptp(seen) == pytest.approx(1.1 * 121.412, rel=0.05)  # mm, the lap and not the beam


@pytest.mark.long
def test_preloaded_frequencies_and_the_backbone_agree_with_the_reference():
    """J. H. Porter and M. R. W. Brake, data of tmdsimpy: flat interface, bending modes, Hz.

    The last tolerances are of the fall below and above the modal amplitude 1e-5.
    """
    case = load_case("brake_reuss")
    asked = case.vibration.model_copy(update={"modes": (5,)})
    case = case.model_copy(update={"vibration": asked})
    jointed = BodiesWithLaws(case.structure, case, [None])
    still, _ = _press(jointed, _laws(jointed, Change()))
    computed = still.modes.frequency[[0, 2, 4]]
    np.testing.assert_allclose(computed, [168.5026, 580.4082, 1177.6498], rtol=0.01)
    sizes = Amplitudes((2.43e-6, 8.94e-6, 3.25e-5, 6.99e-5))
    load = still.mass @ still.modes.shape
    backbone = follow_backbone(still.rest, still.modes, load, 0, sizes)
    damping = case.vibration.material_damping + backbone.damping
    np.testing.assert_allclose(damping, [0.001635, 0.00615, 0.01524, 0.03063], rtol=0.06)
    fall = computed[0] - backbone.frequency
    np.testing.assert_allclose(fall[:2], [0.2092, 1.5837], atol=0.1)
    np.testing.assert_allclose(fall[2:], [5.877, 11.828], rtol=0.05)


@pytest.mark.slow
def test_the_frequencies_without_contact_agree_with_the_reference():
    """Only the bolts join both halves, which may part along them; six modes do not move rigidly."""
    case = load_case("brake_reuss")
    jointed = BodiesWithLaws(case.structure, case, [None])
    parts = jointed.build(_laws(jointed, Change()))
    free = cut_assembly(parts.assembly)
    mass = structure_mass(free, parts.assembly.bodies, [7930.0] * 2)
    squares = np.sort(eigsh(assemble(free).stiffness, 13, mass, sigma=-1e4)[0])
    squares_there = [1.701181e5, 8.196151e5, 1.368695e7, 1.543605e7, 1.871511e7, 1.975941e7]
    np.testing.assert_allclose(np.sqrt(squares[7:]), np.sqrt(squares_there), rtol=0.01)

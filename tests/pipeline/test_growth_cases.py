"""Cases with [growth]: strength and energy of volumes with growing cracks, and of a body."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.fe.mesh_file import box_mesh
from multiscale.pipeline import load_case, run
from multiscale.schema import CRACKED_BODY, VOLUME_GROWTH
from tests.support import case_text, refused_rows, write_body, write_scene

VOLUME = case_text("cracked_volume")
BAR = case_text("cracked_bar")
SIZE = (0.4, 0.1, 0.1)


def write_bars(folder):
    """Write bars of 9 and of 3 hexahedra, named as in the case."""
    for name, count in (("bar", 9), ("coarse", 3)):
        write_body(folder / f"{name}.msh", box_mesh(SIZE, (count, 1, 1)), scale=1.0)


@pytest.fixture(scope="module")
def cracked(tmp_path_factory):
    """Datasets of a bar that cracks, and the folder of their run."""
    folder = tmp_path_factory.mktemp("growth")
    write_bars(folder)
    case = load_case(write_scene(folder, VOLUME + BAR))
    return run(case, folder / "out"), folder / "out"


def test_volumes_have_strengths_and_energies_between_their_intervals(cracked):
    growth = cracked[0]["volume_growth"]
    VOLUME_GROWTH.check(growth)
    whole = growth["share"].to_numpy() == 1.0
    # the energy per area is at most the whole toughness, on the part of the section left sound
    release = 0.6e6**2 * (1.0 - 0.2**2) / 30e9
    assert np.all(growth["volume_energy"].to_numpy() < 1.02 * release)
    assert np.all(growth["volume_energy"].to_numpy()[whole] > 0.5 * release)
    damage = growth["damage"].to_numpy()
    # a circle of .999 of the section overlaps its periodic images
    np.testing.assert_allclose(damage[:, -1], 0.909, atol=1e-3)
    assert np.all(np.diff(damage, axis=1) > -1e-9)
    assert np.all(damage[:, 0] < growth["peak_damage"].to_numpy() + 1e-9)
    mean = np.trapezoid(growth["mean_stress"], growth["mean_opening"])
    assert mean == pytest.approx(float(growth["fracture_energy"]))
    for name in ("strength", "fracture_energy"):
        low, high = growth[f"{name}_mean_law"].to_numpy()
        assert low < float(growth[name]) < high
        exponent = np.log(growth[f"{name}_one_part"].to_numpy())
        assert np.ptp(exponent) == pytest.approx(2.0 * np.log(high / low))  # sqrt(1 + 3)


def test_a_bar_has_the_strength_and_the_energy_of_the_mean_law_on_every_mesh(cracked):
    computed, growth = cracked[0]["cracked_body"], cracked[0]["volume_growth"]
    CRACKED_BODY.check(computed)
    assert int(computed["converged"]) == 1
    assert 1e6 * float(computed["peak_load"]) == pytest.approx(float(growth["strength"]), rel=1e-6)
    energy = float(computed["work"]) / (SIZE[1] * SIZE[2])
    assert energy == pytest.approx(float(growth["fracture_energy"]), rel=0.03)
    assert float(computed["work_mesh"]) < 0.03
    assert float(computed["peak_load_mesh"]) < 1e-6
    whole = growth["share"].to_numpy() == 1.0
    np.testing.assert_allclose(
        1e6 * computed["peak_load_sample"], growth["volume_strength"].to_numpy()[whole], rtol=1e-6
    )


@pytest.mark.slow
def test_a_stated_modulus_widens_the_interval_of_the_energy_of_a_bent_bar(tmp_path):
    write_body(tmp_path / "bar.msh", box_mesh(SIZE, (3, 1, 4)), scale=1.0)
    bent = (
        ('coarser = "coarse.msh"\n', ""),
        ('left = "x", front = "y", bottom = "z"', 'left = "clamped"'),
        ('["1 MPa", 0, 0]', '[0, 0, "0.1 MPa"]'),
    )
    works, halves = [], []
    for modulus in ("29 GPa", "29.58 GPa", "29 GPa +- 40 %"):
        file = write_scene(tmp_path, VOLUME + BAR, *bent, ("29 GPa", modulus))
        body = run(load_case(file), tmp_path / modulus)["cracked_body"]
        works.append(float(body["work"]))
        halves.append(0.5 * np.ptp(np.log(body["work_mean_law"].to_numpy())))
    stated = 0.4 * (works[1] / works[0] - 1.0) / 0.02
    assert abs(stated) > 0.01
    assert halves[2] ** 2 - halves[0] ** 2 == pytest.approx(stated**2, rel=1e-6)


def test_the_shipped_beam_is_of_hexahedra_of_its_size_with_a_notch():
    pytest.importorskip("gmsh", exc_type=Exception)
    for case in (load_case("notched_concrete"), load_case("notched_concrete").quick()):
        beam = case.structure.bodies[0]
        mesh = beam.load()
        sides = np.ptp(mesh.p[:, mesh.t], axis=1)  # of bricks along the axes
        assert np.all(sides[[0, 2]] < 1.001 * beam.element)
        assert np.prod(sides, axis=0).sum() == pytest.approx((1.64 * 0.4 - 0.04 * 0.16) * 0.2)
        assert set(mesh.boundaries) == {"left", "right", "top"}
        assert case.growth.volumes(case.rve)[0][1].edge == 0.1


@pytest.mark.parametrize(("base", "patches", "sentence"), refused_rows("cracked_bar"))
def test_a_case_that_cannot_crack_is_refused_with_a_sentence(base, patches, sentence, tmp_path):
    write_bars(tmp_path)
    text = (VOLUME + BAR).replace("realisations = 3", "realisations = 1")
    with pytest.raises(CaseError, match=sentence):
        run(load_case(write_scene(tmp_path, text, *patches)), tmp_path / "out")


def test_a_body_does_not_crack_without_volumes(tmp_path):
    write_bars(tmp_path)
    volume = VOLUME[VOLUME.index("[rve]") : VOLUME.index("[growth]")]
    with pytest.raises(CaseError, match="takes the cracks of"):
        load_case(write_scene(tmp_path, VOLUME + BAR, (volume, "")))

"""The damage branch of a law: sections parallel to the interface, and the joints that take it."""

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.io import open_law, write_dataset
from multiscale.laws import ModifiedLaw
from multiscale.micro.damage import max_damage, plane_damage
from multiscale.schema import DAMAGE_SECTIONS
from multiscale.upscaling import law_from_dataset, with_damage
from tests.micro.damage.solid import lattice
from tests.support import TWO_BLOCKS, case_of, joints_of, write_law


@pytest.fixture(scope="module")
def sections():
    return max_damage(lattice("simple cubic", 0.3, edge=1.0), level=1, sections=17)


def test_the_branch_is_the_mean_over_parallel_sections_with_its_band(sections, tmp_path):
    law = open_law(write_law(tmp_path / "law.nc"))
    found = with_damage(law, sections)
    along = int(np.argmax(np.abs(sections["normal"].values[:, 2])))
    np.testing.assert_allclose(np.abs(sections["normal"].values[along]), [0.0, 0.0, 1.0], atol=1e-9)
    volume = lattice("simple cubic", 0.3, edge=1.0)
    each = [
        plane_damage(volume, (0.0, 0.0, 1.0), float(at)) for at in sections["offset"].values[along]
    ]
    assert float(found["interface_damage"]) == pytest.approx(np.mean(each))
    low, high = found["interface_damage_band"].values
    assert min(each) <= low < float(found["interface_damage"]) < high <= max(each)
    assert found.attrs["branches"].endswith("damage: measured")
    assert "the error budget does not have this range" in found.attrs["cautions"]


def test_sections_of_other_directions_and_nothing_left_are_refused(sections, tmp_path):
    law = open_law(write_law(tmp_path / "law.nc"))
    keep = np.abs(sections["normal"].values[:, 2]) < 0.8
    with pytest.raises(CaseError, match=r"no section of the volume is parallel .* normal is its"):
        with_damage(law, sections.isel(direction=keep))
    with pytest.raises(CaseError, match="nothing is left of the sections"):
        with_damage(law, sections.assign(damage=1.0 + 0.0 * sections["damage"]))


def test_joints_carry_what_the_damage_leaves(sections, tmp_path):
    write_law(tmp_path / "law.nc")
    write_dataset(sections, tmp_path / "rve.nc", DAMAGE_SECTIONS)
    keys = '[interface]\nlaw = "law.nc"\ndamage_file = "rve.nc"'
    text = TWO_BLOCKS.replace("[interface]", keys)
    case = case_of(tmp_path, text)
    bodies, (law,) = joints_of(case)
    (bed,) = bodies.sliders(case, [law])
    assert isinstance(bed.normal, ModifiedLaw)
    lost, sound = float(law["interface_damage"]), law_from_dataset(law)
    gap = sound.gap_at(np.array(1e7))
    assert float(bed.normal.pressure(gap)) == pytest.approx((1.0 - lost) * 1e7)
    with pytest.raises(CaseError, match="damage and damage_file, which both tell the damage"):
        case_of(tmp_path, text.replace('"rve.nc"', '"rve.nc"\ndamage = [0.1]'))

"""Cases of coated bodies: their cells, refusals and reports."""

import numpy as np
import pytest
import xarray as xr

from multiscale.errors import CaseError
from multiscale.laws.bulk.bulk_law import contact_modulus
from multiscale.micro.elastic.elastic_cells import flat_compliance
from multiscale.pipeline import load_case, run
from multiscale.pipeline.case import shipped_cases
from multiscale.pipeline.case_cells import cell_of, coating_caution, surface_modulus
from multiscale.pipeline.stages import ensembles
from multiscale.surfaces.surface import Surface
from tests.support import case_of, case_text

COATING = """
[[body_1.coating]]
thickness = "10 um"
youngs_modulus = "350 GPa"
poissons_ratio = 0.25
"""

TEXT = case_text("coated")


def flat_surface(case):
    return Surface(np.zeros(case.cell.points), case.cell.size)


def symbol(case):
    return flat_compliance(cell_of(case, flat_surface(case))).flat[1:]


def test_waves_longer_than_an_oxide_see_the_steel_and_shorter_waves_the_oxide(tmp_path):
    case = case_of(tmp_path, TEXT)
    bare, coated = symbol(case.without_coatings()), symbol(case)
    assert np.all(coated < bare)
    assert 0.85 < coated[0] / bare[0] < 1.0
    oxide = contact_modulus((350e9, 0.25), (210e9, 0.3))
    assert surface_modulus(case) == pytest.approx(oxide)
    assert coated[15] / bare[15] == pytest.approx(
        contact_modulus((210e9, 0.3), (210e9, 0.3)) / oxide, rel=0.1
    )
    alike = ("350 GPa", "210 GPa"), ("0.25", "0.3")
    np.testing.assert_allclose(symbol(case_of(tmp_path, TEXT, *alike)), bare, rtol=1e-4)


def test_a_coated_case_has_a_law_with_bands_and_a_budget(tmp_path):
    results = run(case_of(tmp_path, TEXT), tmp_path / "out")
    law = results.interface_law
    assert law.sizes["sample"] == 20
    assert np.isfinite(law["error_total"].sel(quantity=["mean_gap", "stiffness"])).all()
    assert "without coatings" in law.attrs["how_small_slopes"]


def test_the_hardness_of_the_coating_caps_local_pressures(tmp_path):
    hard = COATING + 'hardness = "12 GPa"\n'
    direct = ("0.3\n[body_1.surface]", '0.3\nhardness = "2 GPa"\n[body_1.surface]')
    case = case_of(tmp_path, TEXT, (COATING, hard), direct)
    assert case.hardness == 12e9
    assert cell_of(case, flat_surface(case)).hardness == 12e9
    (text,) = (caution for caution in case.cautions() if "spots wider" in caution)
    assert "reach 12 GPa, above the hardness of body_1 below its coating" in text
    assert "10 µm" in text
    soft = case_of(
        tmp_path, TEXT, (COATING, hard), direct, METAL
    )  # body_2 of 2 GPa caps the pressures
    assert soft.hardness == 2e9
    assert not [caution for caution in soft.cautions() if "spots wider" in caution]
    below = case_of(tmp_path, TEXT, direct)
    assert below.hardness == 2e9
    assert not [caution for caution in below.cautions() if "spots wider" in caution]


def test_one_conforming_body_replaces_both_within_the_limits_of_a_caution(tmp_path):
    conforming = ('geometry = "flat"', 'geometry = "conforming"')
    assert coating_caution(case_of(tmp_path, TEXT)) == []
    caution = coating_caution(case_of(tmp_path, TEXT, conforming))
    assert "gets 2 layer(s) of elements" in caution[0]
    assert "error of its compliance of up to 0.4" in caution[1]
    both = (COATING, COATING + COATING.replace("body_1", "body_2"))
    assert len(coating_caution(case_of(tmp_path, TEXT, conforming, both))) == 1  # alike bodies


def test_a_coating_thicker_than_the_cells_are_deep_is_refused(tmp_path):
    with pytest.raises(CaseError, match="m leaves no body below"):
        symbol(case_of(tmp_path, TEXT, ('"10 um"', '"200 um"')))


def test_sheared_cells_have_the_coatings_of_both_bodies(tmp_path):
    shear = '[micro.shear]\nfriction_coefficient = 0.3\npressures = ["40 MPa"]\n[law]'
    case = case_of(tmp_path, TEXT, ("[law]", shear))
    pair = ensembles._pair(case, (flat_surface(case),) * 2)
    assert [body.coating for body in pair.bodies] == [case.body_1.stack, ()]
    assert pair.bodies[0].moduli[1][-1] == pytest.approx(350e9 / 2.5)


def test_the_stiffness_ratio_of_theory_is_refused_for_coated_bodies(tmp_path):
    text = shipped_cases()["bolted_lap"].read_text(encoding="utf-8")
    start, end = text.index("[micro.shear]"), text.index("[structure]")
    bare = text[:start] + text[end:].replace("[statics]", "friction = 0.2\n[statics]")
    (tmp_path / "bare.toml").write_text(bare)
    (tmp_path / "coated.toml").write_text(bare.replace("[body_2]", COATING + "[body_2]", 1))
    case = load_case(tmp_path / "bare.toml")
    with pytest.raises(CaseError, match="the stiffness_ratio of theory is derived for bodies of o"):
        load_case(tmp_path / "coated.toml")
    law = xr.Dataset(attrs={"coatings": "body_1"})
    with pytest.raises(CaseError, match="theory has no ratio for the coatings of body_1"):
        case.interface.complete(law, 0.3, 1e7, strict=False)


METAL = ("[cell]", 'hardness = "2 GPa"\n[cell]')

"""The real contact: its mean pressure, bodies that flow, and refusals."""

import numpy as np
import pytest

from multiscale.pipeline import load_case
from multiscale.pipeline.real_contact import real_pressure, with_real_pressure
from multiscale.schema import MICRO_RESPONSE
from tests.upscaling.responses import response_of

MODULUS = 210e9 / (2.0 * (1.0 - 0.3**2))  # contact modulus of steel on steel


def response(*fractions):
    """Two cells, one above and one below the mean, at 1, 2, 3 ... MPa."""
    area = np.array(fractions) * np.array([[0.9], [1.1]])
    p = 1e6 * np.arange(1.0, 1.0 + area.shape[1])
    return response_of(np.full(area.shape, 1e-6), p, area=area)


def steel(**changes):
    return load_case("ground_steel").model_copy(update=changes)


def metal(first, second, geometry="conforming"):
    """Steel of two hardnesses, Pa."""
    case = load_case("ground_steel")
    bodies = {
        f"body_{k}": body.model_copy(update={"hardness": hardness})
        for k, body, hardness in zip((1, 2), case.bodies, (first, second), strict=True)
    }
    cell = case.cell.model_copy(update={"geometry": geometry})
    return case.model_copy(update=bodies | {"cell": cell})


def test_the_real_pressure_is_the_load_over_the_area_that_touches():
    changed = with_real_pressure(steel(), response(0.1, 0.0, 0.5))
    MICRO_RESPONSE.check(changed)
    expected = [[1e6 / 0.09, np.nan, 3e6 / 0.45], [1e6 / 0.11, np.nan, 3e6 / 0.55]]
    np.testing.assert_allclose(changed["real_pressure"], expected)
    np.testing.assert_array_equal(real_pressure(2e6, np.array([0.0, 0.5])), [np.nan, 4e6])


@pytest.mark.parametrize(("share", "sentence"), [(0.0099, False), (0.0101, True)])
def test_elastic_metal_is_a_caution_above_a_hundredth_of_the_contact_modulus(share, sentence):
    touching = 1e6 / (share * MODULUS)
    changed = with_real_pressure(steel(), response(touching))
    assert changed.attrs["behaviour"] == ("The answer is elastic, as no body has a hardness.")
    assert ("give the hardness, or set elastic = true" in changed.attrs["cautions"]) == sentence
    meant = with_real_pressure(steel(elastic=True), response(touching))
    assert meant.attrs["cautions"] == ""
    assert "elastic" in meant.attrs["behaviour"]


def test_a_hardness_is_compared_with_the_real_pressure_and_reports_who_flows():
    changed = with_real_pressure(metal(2.8e9, 1.4e9), response(1e6 / 1.26e9))
    assert changed.attrs["behaviour"] == (
        "The composite body flows above a yield stress of 0.5 GPa: the hardness "
        "of 1.4 GPa of body_2, the softer body over 2.8, minus the part of hardening. The mean "
        "real pressure reaches 0.90 of that hardness."
    )
    assert changed.attrs["cautions"] == ""
    above = with_real_pressure(metal(2e9, 2e9), response(1e6 / 3e9))
    assert "of both bodies over 2.8" in above.attrs["behaviour"]
    assert "3 GPa, 1.50 of the hardness" in above.attrs["cautions"]
    flat = with_real_pressure(metal(2e9, None, "flat"), response(1e6 / 2e9))
    assert "limited to the hardness of 2 GPa of body_1" in flat.attrs["behaviour"]


def test_the_keys_of_flow_and_of_the_law_of_a_case_change_no_cell():
    law = steel().law.model_copy(update={"extrapolate": True})
    assert steel(elastic=True, law=law).identity() == steel().identity()

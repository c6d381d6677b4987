"""Cases that are refused when they are read: rows of ``refused.toml``, patches of a base text."""

import pytest

from multiscale.errors import CaseError
from multiscale.pipeline import load_case
from multiscale.pipeline.case import shipped_cases
from tests.pipeline import (
    test_body_scenes,
    test_case,
    test_chain,
    test_coated_cases,
    test_conducting_cases,
    test_control_cells,
    test_grain_scenes,
    test_leaking_cases,
    test_metal_cases,
    test_planner,
    test_representative_volume,
    test_scenes,
    test_sheared_cells,
    test_slide,
)
from tests.support import SCENES, refused_rows, write_scene

SHIPPED = shipped_cases()
OWN_TEXT = ("mesh_cell", "overhang_cell", "tyre_on_road")
CHAIN, SHEAR = test_sheared_cells.CHAIN, test_sheared_cells.SHEAR
CELLS, VOLUME = test_chain.CELLS, test_representative_volume.TEXT
PORES = VOLUME + test_representative_volume.RECIPE
HALVED = CHAIN.replace("realisations = 3", "realisations = 3\ncoarser = 1").replace(SHEAR, "")

BASES = {
    "nothing": 'title = "x"\n',
    "steel": test_case.TEXT,
    **{name: SHIPPED[name].read_text(encoding="utf-8") for name in OWN_TEXT},
    "cells": CELLS,
    "unpressed": CELLS[: CELLS.index("[micro]")],
    "cells_and_blocks": CELLS + test_chain.BLOCKS,
    "rough": CELLS + test_chain.ROUGH,
    "blocks": 'title = "x"\n' + test_chain.BLOCKS,
    "chain": test_chain.CHAIN,
    "two_blocks": test_chain.TWO_BLOCKS,
    "rough_blocks": test_body_scenes.BLOCKS,
    "plate": test_body_scenes.PLATE,
    "tensegrity_grid": test_scenes.STATIC,
    "equivalent_plate": (SCENES / "equivalent_plate.toml").read_text(encoding="utf-8"),
    "sudden_unloading": test_scenes.MOVING,
    "hanging": test_scenes.HANGING,
    "deposit": test_grain_scenes.DEPOSIT,
    "coated": test_coated_cases.TEXT,
    "conducting": test_conducting_cases.TEXT,
    "control": test_control_cells.TEXT,
    "seal": test_leaking_cases.TEXT,
    "metal": test_metal_cases.TEXT,
    "elastic": test_metal_cases.ELASTIC,
    "planned": test_planner.CASE,
    "sheared": CHAIN,
    "unsheared": CHAIN.replace(SHEAR, ""),
    "halved": HALVED.replace("[interface]", "[interface]\nfriction = 0.2"),
    "slide": test_slide.ELASTIC + test_slide.SLIDE,
    "volume": VOLUME,
    "pores": PORES,
    "crack": VOLUME + test_representative_volume.CRACK,
    "porous_bar": PORES + test_representative_volume.BAR,
    "bar": 'title = "No volume"' + test_representative_volume.BAR,
}


@pytest.mark.parametrize(("base", "patches", "sentence"), refused_rows(*BASES))
def test_a_case_is_refused_in_a_sentence_with_its_place(tmp_path, base, patches, sentence):
    path = write_scene(tmp_path, BASES[base], *patches)
    with pytest.raises(CaseError, match=sentence) as caught:
        load_case(path)
    assert str(caught.value).startswith(f"{path}: ")

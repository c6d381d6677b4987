"""Case files: reading, and the messages of refused files."""

from functools import partial
from typing import Annotated

import pytest

from multiscale.errors import CaseError
from multiscale.pipeline import load_case
from multiscale.pipeline.case import shipped_cases
from multiscale.pipeline.tables.toml_model import Quick, Settings, at_most
from tests.support import steel_text, write_scene

OTHERS = (
    "brake_reuss",
    "holed_strip",
    "notched_concrete",
    "porous_bracket",
    "seal",
    "third_body",
    "tyre_on_road",
)
"""Shipped cases without a joint of rough blocks or without cells."""

JOINTS = [name for name in shipped_cases() if name not in OTHERS]

TEXT = steel_text()


@pytest.fixture
def changed(tmp_path):
    """Write the shipped case with some text replaced and return its path."""

    return partial(write_scene, tmp_path, TEXT)


@pytest.mark.parametrize("name", JOINTS)
def test_shipped_cases_are_valid_and_in_si(name):
    case = load_case(name)
    assert 1e-9 < case.cell.size[0] < 1.0
    assert case.micro.pressures[0] < case.statics.preloads[0]
    assert case.statics.preloads[-1] < case.micro.pressures[-1]


def test_every_fault_is_listed_at_once(changed):
    path = changed(("rms_height", "rms_heigth"), ('"210 GPa"', '"210 m"'))
    with pytest.raises(CaseError) as caught:
        load_case(path)
    assert len(str(caught.value).splitlines()) >= 2


def test_cautions_name_coarse_grids_shallow_cells_and_few_realisations(changed):
    assert not [*load_case("ground_steel").cautions()]
    assert "has 4.0 points" in next(load_case("ground_steel").quick().cautions())
    (caution,) = load_case(changed(("layers = 14", 'layers = 14\ndepth = "200 um"'))).cautions()
    assert "makes the longest mode 37 % too stiff" in caution
    (caution,) = load_case(changed(("realisations = 5", "realisations = 2"))).cautions()
    assert "there are no bands below 3" in caution


def test_identity_depends_only_on_the_micro_scale():
    case = load_case("ground_steel")
    other_joint = case.model_copy(update={"structure": load_case("road_texture").structure})
    other_seed = case.model_copy(update={"micro": case.micro.model_copy(update={"seed": 99})})
    assert case.identity() == other_joint.identity()
    assert case.identity() != other_seed.identity()
    assert case.identity() != case.quick().identity()


def test_a_case_written_by_a_run_is_the_same_case(tmp_path):
    for name in JOINTS:
        for case in (load_case(name), load_case(name).quick()):
            (tmp_path / "case.toml").write_text(case.to_toml(), encoding="utf-8")
            assert load_case(tmp_path / "case.toml") == case


def test_a_folder_of_the_same_name_does_not_hide_a_shipped_case(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ground_steel").mkdir()
    (tmp_path / "elsewhere").mkdir()
    assert load_case("ground_steel").title == "Ground steel on ground steel"
    with pytest.raises(CaseError, match="elsewhere is a folder; give the case file in it"):
        load_case("elsewhere")


def test_an_instrument_file_is_looked_for_next_to_its_case(changed):
    start = TEXT.index("rms_height")
    end = TEXT.index("\n\n[body_2]")
    path = changed((TEXT[start:end], 'file = "map.al3d"\nperiodic = "window"'))
    assert load_case(path).body_1.surface.file == path.parent / "map.al3d"


def test_a_fault_is_shown_in_its_line_with_a_caret(tmp_path):
    file = tmp_path / "case.toml"
    lines = ['title = "x"', "[body_1]", "  poissons_rato = 0.3", "[cell]", "layers = -1"]
    file.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(CaseError) as raised:
        load_case(file)
    text = str(raised.value)
    for number, name in ((3, "poissons_rato"), (5, "layers")):
        begin = f"  line {number}: "
        at = len(begin) + lines[number - 1].index(name)
        assert f"\n{begin}{lines[number - 1]}\n{' ' * at}{'^' * len(name)}" in text
    assert text.count("^\n") + text.endswith("^") == 2  # a missing entry has no line


def test_a_fault_of_a_list_of_tables_or_of_a_sweep_is_shown_where_it_stands(tmp_path):
    file = tmp_path / "case.toml"
    text = '[[structure.interfaces]]\nlaw = "a.nc"\n[[structure.interfaces]]\nlow = 1\n'
    file.write_text(f'title = "x"\n[structure]\nkind = "bodies"\n{text}', encoding="utf-8")
    with pytest.raises(CaseError, match=r"has no key 'low'.*\n  line 7: low = 1\n +\^\^\^"):
        load_case(file)


class Inner(Settings):
    """A table with a limit of quick cases."""

    count: Annotated[int, at_most(3)] = 7


class Outer(Settings):
    """A table with inner tables."""

    inner: Inner = Inner()
    listed: tuple[Inner, ...] = (Inner(), Inner(count=2))
    absent: Annotated[int | None, at_most(3)] = None
    size: Annotated[float, Quick(lambda table, size: size * table.inner.count)] = 2.0


def test_quick_values_stand_at_their_fields_and_reach_inner_tables():
    small = Outer().smaller()
    assert [inner.count for inner in (small.inner, *small.listed)] == [3, 3, 2]
    assert (small.absent, small.size) == (None, 14.0)  # of the table before it is smaller

"""Tables that other codes read: their syntax, their units, and the law between their points."""

import csv

import numpy as np
import pytest

from multiscale.errors import CaseError
from multiscale.io import save_law
from multiscale.laws import Exponential, PowerLaw
from multiscale.upscaling import assume_shear, fit_law, law_from_dataset, write_law_table
from multiscale.upscaling.export import pressure_overclosure, write_pressure_overclosure
from tests.upscaling.responses import PRESSURE, exponential_gaps, response_of


def read_input_file(path):
    """Keyword lines with their data, as CalculiX reads them: 20 characters a field."""
    cards = []
    for line in path.read_text().splitlines():
        if line.startswith("**") or not line:
            continue
        assert len(line) <= 132
        if line.startswith("*"):
            cards.append((line.upper().replace(" ", ""), []))
        else:
            fields = [field.strip() for field in line.split(",")]
            assert all(len(field) <= 20 for field in fields)
            cards[-1][1].append([float(field) for field in fields])
    return cards


@pytest.mark.parametrize("law", [Exponential(4e8, 0.45e-6), PowerLaw(4e8, 1.2e-6, 2.5)])
@pytest.mark.parametrize("tolerance", [1e-2, 1e-3])
def test_chords_stay_within_the_tolerance_above_the_law(law, tolerance):
    table = pressure_overclosure(law, (1e6, 1e8), tolerance=tolerance)
    p, overclosure, first = table.pressure, table.overclosure, table.first_contact
    assert p[0] == 0.0
    assert overclosure[0] == 0.0
    assert np.all(np.diff(p) > 0.0)
    assert np.all(np.diff(overclosure) > 0.0)
    assert np.all(np.diff(np.diff(p) / np.diff(overclosure)) > 0.0)  # ever stiffer
    along = np.geomspace(1e6, 1e8, 5000)
    result = np.interp(first - law.gap_at(along), overclosure, p)
    assert np.max(result / along - 1.0) <= 1.05 * tolerance
    assert np.min(result / along - 1.0) >= -1e-9


def test_the_input_file_holds_the_law_in_the_units_of_the_model(tmp_path):
    dataset = fit_law(response_of(exponential_gaps(4), title="ground steel"), n_samples=0)
    file = tmp_path / "rough.inp"
    write_pressure_overclosure(dataset, file, name="JOINT", length_unit="mm", pressure_unit="MPa")
    (interaction, empty), (behaviour, rows) = read_input_file(file)
    assert interaction == "*SURFACEINTERACTION,NAME=JOINT"
    assert empty == []
    assert behaviour == "*SURFACEBEHAVIOR,PRESSURE-OVERCLOSURE=TABULAR"
    pressure, overclosure = np.array(rows).T
    assert pressure[0] == overclosure[0] == 0.0
    assert pressure[-2] == pytest.approx(1e-6 * PRESSURE[-1])
    assert len(rows) <= 40
    law = law_from_dataset(dataset)
    gap = law.gap_at(1e6 * pressure[1:-1])
    np.testing.assert_allclose(np.diff(overclosure[1:-1]), -1e3 * np.diff(gap), rtol=1e-6)
    slope = np.diff(pressure) / np.diff(overclosure)
    assert pressure[-1] == pytest.approx(10.0 * pressure[-2])
    assert slope[-1] == pytest.approx(slope[-2], rel=1e-6)
    head = file.read_text()
    assert "pressure (MPa), overclosure (mm)" in head
    assert "ground steel" in head
    apart = float(head.split("mean planes ")[1].split()[0])
    assert overclosure[1] == pytest.approx(apart - 1e3 * gap[0], rel=1e-3)


def test_a_table_for_faces_has_its_length_by_its_forty_first_overclosure(tmp_path):
    dataset, file = fit_law(response_of(exponential_gaps(4)), n_samples=0), tmp_path / "rough.inp"
    write_pressure_overclosure(dataset, file, tolerance=1e-2)
    plain = np.array(read_input_file(file)[1][1])
    assert "SURFACE TO SURFACE\n** it carries no load" in file.read_text()
    assert "convex_decreasing, 4 realisations\n" in file.read_text()
    write_pressure_overclosure(dataset.assign_attrs(n_realisations=1), file)
    assert "convex_decreasing, 1 realisation\n" in file.read_text()
    write_pressure_overclosure(dataset, file, tolerance=1e-2, face_to_face=True)
    rows = np.array(read_input_file(file)[1][1])
    np.testing.assert_array_equal(rows[: len(plain)], plain)
    assert len(rows) == 41
    assert int(rows[-1, 1]) == len(plain) <= 20
    slope = np.diff(rows[:, 0]) / np.diff(rows[:, 1])
    np.testing.assert_allclose(slope[len(plain) - 1 :], slope[len(plain) - 2], rtol=1e-6)


def test_overclosures_that_calculix_would_move_apart_are_refused(tmp_path):
    """A nanometre in metres is 1e-9, and its table has steps below 1e-10."""
    fine = fit_law(response_of(1e-3 * exponential_gaps(1)), n_samples=0)
    with pytest.raises(
        CaseError, match=r"less than the 1e-10 that CalculiX .* smaller length_unit"
    ):
        write_pressure_overclosure(fine, tmp_path / "a.inp", length_unit="m", pressure_unit="Pa")
    write_pressure_overclosure(fine, tmp_path / "a.inp")


def test_the_table_has_units_in_its_head_and_the_bands_of_the_law(tmp_path):
    law = fit_law(response_of(exponential_gaps(6)), n_samples=100)
    write_law_table(law, tmp_path / "law.csv")
    with (tmp_path / "law.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [
        "pressure (MPa)",
        "gap (um)",
        "stiffness (MPa/um)",
        "contact fraction (1)",
        "gap low 95 % (um)",
        "gap high 95 % (um)",
    ]
    p = 1e6 * np.array([float(row["pressure (MPa)"]) for row in rows])
    gap = 1e-6 * np.array([float(row["gap (um)"]) for row in rows])
    np.testing.assert_allclose(gap, law_from_dataset(law).gap_at(p), rtol=1e-8)
    for row in rows:
        assert float(row["gap low 95 % (um)"]) < float(row["gap (um)"])
        assert float(row["gap high 95 % (um)"]) > float(row["gap (um)"])


def test_a_table_without_samples_leaves_the_bands_out(tmp_path):
    write_law_table(fit_law(response_of(exponential_gaps(1))), tmp_path / "law.csv")
    assert "95 %" not in (tmp_path / "law.csv").read_text()


@pytest.mark.parametrize("code", ["abaqus", "calculix"])
def test_friction_sticks_with_the_stiffness_of_the_interface_at_one_pressure(tmp_path, code):
    law = fit_law(response_of(exponential_gaps(4)), n_samples=0)
    dataset = assume_shear(law, friction=0.3, stiffness_ratio=0.8)
    file, at = tmp_path / "rough.inp", 2e7
    write_pressure_overclosure(dataset, file, friction_for=code, stick_pressure=at)
    *normal, (keyword, (numbers,)) = read_input_file(file)
    assert len(normal) == 2
    single_law = law_from_dataset(law)
    stiffness = 0.8 * float(single_law.stiffness(single_law.gap_at(np.array(at))))  # Pa/m
    if code == "calculix":
        assert keyword == "*FRICTION"
        assert numbers == pytest.approx([0.3, 1e-9 * stiffness])  # MPa/mm
    else:
        keyword, slip = keyword.split(",ELASTICSLIP=")
        assert keyword == "*FRICTION"
        assert numbers == [0.3]
        assert 0.3 * 20.0 / float(slip) == pytest.approx(1e-9 * stiffness)  # MPa/mm
    assert "as stiff as the interface at 20 MPa" in file.read_text()


@pytest.mark.parametrize(
    ("realisations", "samples", "sentence"), [(3, 200, "3 realisations"), (6, 20, "20 samples")]
)
def test_a_table_of_too_few_realisations_or_samples_leaves_the_bands_out(
    realisations, samples, sentence, command, tmp_path
):
    law = fit_law(response_of(exponential_gaps(realisations)), n_samples=samples)
    save_law(law, tmp_path / "law.nc")
    status, _, error = command("export", tmp_path / "law.nc", "law.csv")
    assert status == 0
    assert f"the table has no band: {sentence} are too few for a band of 95 %" in error
    text = (tmp_path / "law.csv").read_text()
    assert "gap low" not in text
    assert len(text.splitlines()) == 42

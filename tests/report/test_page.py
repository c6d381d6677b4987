"""The page of a run: figures zoom without a script, and nothing comes from elsewhere."""

import base64
import re
import subprocess
from shutil import copytree, which

import numpy as np
import pytest
from matplotlib.image import imread

from multiscale.pipeline import Sweep, load_case, run_sweep
from multiscale.report import draw_figures, write_report, write_reports
from tests.support import slow


@pytest.fixture(scope="module")
def page(run_folder):
    return write_report(run_folder).read_text(encoding="utf-8")


def photograph(text, folder, size):
    """Show a page in a browser and return the picture."""
    (folder / "page.html").write_text(text, encoding="utf-8")
    command = [
        "chromium",
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--disable-background-networking",
        f"--user-data-dir={folder / 'profile'}",
        f"--window-size={size[0]},{size[1]}",
        f"--screenshot={folder / 'page.png'}",
        (folder / "page.html").resolve().as_uri(),
    ]
    subprocess.run(command, capture_output=True, timeout=120, check=True)
    return imread(folder / "page.png")


def test_the_page_has_no_script_and_fetches_nothing(page):
    assert "<script" not in page
    assert re.findall(r"(?:src|href)=\"(?!data:|#part-)", page) == []


def test_the_page_has_the_result_the_method_and_the_cautions(page):
    matches = re.findall(r"<h2 id=.*?>(.*?)</h2>", page)
    assert re.findall(r'<li><a href="#part-\d+">(.*?)</a>', page) == matches
    assert matches == [
        "Joint",
        "Error budget",
        "Sensitivity",
        "Interface law",
        "Contact",
        "Surface",
        "Time and error",
        "Inputs",
        "Work and provenance",
        "Citation",
    ]
    assert page.count("Caution:") == 3  # two grids, and the pressure of elastic spots
    assert "multiscale 0" in page.split("Work and provenance</h2>")[1]
    assert "numpy" in page.split("Work and provenance</h2>")[1]
    assert "(from 2 MPa to 240 MPa)" in page
    assert re.search(r"<td>[\d.]+ \.\.\. [\d.]+\s\+\s\?</td>", page)  # an interval
    assert re.findall(r"<td>micro.unload</td><td>false</td>", page)


def test_figures_across_the_page_are_those_with_several_panels(page):
    across = page.count('<figure class="across">')
    assert 0 < across < page.count("<figure class=")


def test_laws_and_inputs_are_downloads_of_the_page(page, run_folder):
    result = dict(re.findall(r'<a download="(.*?)" href="data:text/plain;base64,(.*?)">', page))
    assert b"PRESSURE-OVERCLOSURE" in base64.b64decode(result["abaqus.inp"])
    assert base64.b64decode(result["case.toml"]) == (run_folder / "case.toml").read_bytes()


def test_the_budget_states_each_term_in_numbers_or_that_it_is_unknown(page):
    budget = page.split("Error budget</h2>")[1].split("</table>")[0]
    rows = [re.findall(r"<td>(.*?)</td>", row) for row in budget.split("</tr>")[1:-1]]
    lines = {term: values for term, *values in rows}
    assert all(float(value) > 0.0 for value in lines["sampling"][:-1])
    assert set(lines["cell size"][:-1]) == {"unknown"}
    assert "without unknown terms: cell size" in lines["total"][-1]


def test_no_key_and_no_formula_stands_in_the_sentences(page):
    prose = re.findall(r"<p.*?>(.*?)</p>", page)
    assert len(prose) > 12
    assert not [item for item in prose if re.search(r"body_|[a-z]_[a-z]|\^|sum \(", item)]


def test_inputs_are_shown_as_they_were_typed(page):
    assert "<td>cell.size</td><td>800 um, 800 um</td>" in page
    assert "<td>body_1.youngs_modulus</td><td>210 GPa</td>" in page


def test_unknown_terms_are_named_by_the_keys_of_the_case(page):
    sentence = "not known: cells of one size were solved; a target in [accuracy] solves others"
    assert sentence in page
    assert "not known: cells on one grid were solved; give coarser = 1 in [micro]" in page
    assert "not known: pass" not in page


def test_the_answer_shows_the_interface_the_bodies_and_that_it_is_elastic(page):
    answer = page[: page.index(">Joint</h2>")]
    first = re.search(r'</h1>\s*<p class="answer">(.*?)</p>', answer)[1]
    assert re.match(r"At a preload of 40 MPa the joint has a stiffness of [\d.]+ MPa/µm ± ", first)
    assert re.search(
        r"[\d.]+ % of its area touches, under a mean pressure of [\d.]+ MPa ± ", answer
    )
    assert re.search(
        r"interface has [\d.]+ MPa/µm ± [\d.]+ % or more, the bodies 21 MPa/µm\.", answer
    )
    assert "The answer is elastic, as no body has a hardness." in page
    assert "A cell of 0.8 mm is 0.08 of the edge of the interface, 10 mm." in page


@pytest.mark.slow
@pytest.mark.skipif(which("chromium") is None, reason="needs the browser chromium")
@pytest.mark.parametrize("size", [(1200, 900), *slow((360, 740))], ids=["desk", "phone"])
def test_a_figure_that_is_clicked_covers_the_page(page, tmp_path, size):
    start = page.rindex('<input type="checkbox"', 0, page.index('alt="surface"'))
    zoomed = page[:start] + page[start:].replace("<input", "<input checked", 1)
    picture = photograph(zoomed, tmp_path, size)[..., :3]
    assert not np.array_equal(picture, photograph(page, tmp_path, size)[..., :3])
    coloured = np.ptp(picture, axis=2) > 0.2  # blue and red heights: the text is grey
    assert coloured.mean() > 0.2


def test_the_page_of_a_sweep_has_a_row_for_each_point_and_names_the_failed_points(
    run_folder, tmp_path
):
    case = load_case(run_folder / "case.toml")
    rough = case.model_copy(update={"cell": case.cell.model_copy(update={"points": (16, 16)})})
    sweep = Sweep("Two <grids>", ("cell.points",), (case, rough), (("[64, 64]",), ("[16, 16]",)))
    (tmp_path / "points").mkdir()
    copytree(run_folder, sweep.folders(tmp_path)[0])
    joined = run_sweep(sweep, tmp_path)
    lines = []
    write_reports(tmp_path, joined, progress=lambda *part: lines.append(part))
    assert lines == [(1, 1, "reports")]
    draw_figures(tmp_path)
    page = write_report(tmp_path).read_text(encoding="utf-8")
    assert "<h1>Two &lt;grids&gt;</h1>" in page
    assert "At the end of the 1 with a result of 2 points: joint stiffness" in page
    refused = r"at points of cell = \[16, 16\]: no result: .body_1.surface. .*cannot carry"
    assert re.findall(rf"Caution:</strong> {refused}", page)
    assert re.findall(
        r"Caution:</strong> at every point with a result: the shortest wavelength of", page
    )
    (link,) = re.findall(r'<td><a href="(.*?)">1</a></td><td>\[64, 64\]</td>', page)
    assert (tmp_path / link).is_file()
    assert link.startswith("points/points-64-64-")
    steps = page.split("All steps</h2>")[1]
    assert steps.count("<td>[64, 64]</td>") == 6  # preloads
    assert re.search(r"<td>40</td><td>18\.\d+ ± 2\.\d+ % or more</td>", steps)
    assert 'alt="sweep joint stiffness"' in page
    assert "multiscale 0" in page.split("Work and provenance</h2>")[1]

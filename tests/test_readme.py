"""Every block of Python in the README runs as it stands."""

from pathlib import Path

import numpy as np
import pytest

from tests.support import write_law

README = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")


def blocks():
    """Blocks of Python by the heading above them, numbered where there are several."""
    found = {}
    for section in README.split("\n## ")[1:]:
        title, *parts = section.split("```python\n")
        for k, part in enumerate(parts):
            name = title.splitlines()[0] + (f", {k + 1}" if k else "")
            found[name] = part.split("```")[0]
    return found


def damage(names):
    sections = names["sections"]
    assert float(sections["mean_damage"]) < 0.15 < float(sections["maximum_damage"])
    assert np.linalg.eigvalsh(names["stiffness"]).min() > 0.0
    assert np.isfinite(float(names["life"]["cycles_to_rupture"]))


def laws(names):
    assert names["budget"].attrs["unknown"] == "cell size, scale separation"
    assert "*SURFACE BEHAVIOR" in Path("rough_joint.inp").read_text()


def rough_joint(names):
    joint = names["joint"]
    assert joint["converged"].values.all()
    assert np.all(np.diff(joint["joint_stiffness"].values[:3]) > 0.0)  # grows with the preload
    assert np.all(joint["cycle_energy"].values > 0.0)
    np.testing.assert_allclose(
        joint["open_fraction"] + joint["stick_fraction"] + joint["slip_fraction"], 1.0
    )


CHECKS = {
    "Damage": damage,
    "Laws and their errors": laws,
    "Substructures and rough joints": rough_joint,
}
"""What the names that a block leaves must satisfy."""


@pytest.mark.parametrize("name", blocks())
def test_a_block_of_the_readme_runs(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("results").mkdir()
    write_law(Path("results/interface_law.nc"))  # what the main command leaves
    names = {}
    exec(compile(blocks()[name], "README.md", "exec"), names)
    if name in CHECKS:
        CHECKS[name](names)


def test_every_check_is_of_a_block():
    assert set(CHECKS) <= set(blocks())

"""What the README says of damage runs, and says what it is said to."""

from pathlib import Path

import numpy as np


def test_the_block_on_damage_runs():
    text = (Path(__file__).parents[3] / "README.md").read_text(encoding="utf-8")
    section = text.split("## Damage\n")[1].split("\n## ")[0]
    names = {}
    exec(compile(section.split("```python\n")[1].split("```")[0], "README.md", "exec"), names)
    sections = names["sections"]
    assert float(sections["mean_damage"]) < 0.15 < float(sections["maximum_damage"])
    assert np.linalg.eigvalsh(names["stiffness"]).min() > 0.0
    assert np.isfinite(float(names["life"]["cycles_to_rupture"]))

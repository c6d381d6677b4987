"""The README's example of a cell at large strain runs as it stands."""

from pathlib import Path


def test_the_example_of_a_cell_at_large_strain_runs(capsys):
    text = (Path(__file__).parents[3] / "README.md").read_text(encoding="utf-8")
    section = text.split("## Large strain", 1)[1]
    block = section.split("```python", 1)[1].split("```", 1)[0]
    names: dict[str, object] = {}
    exec(compile(block, "README.md", "exec"), names)
    assert "flowing_fraction" in capsys.readouterr().out
    assert names["response"]["converged"].values.all()

"""Compare values of the package with published and exact values.

    python workflows/manual/published.py

from the root of a checkout computes every row again and writes ``workflows/published.md``.
"""

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from time import process_time

import numpy as np

from multiscale.macro import tensegrity_grid
from multiscale.micro import Cell, Surface, solve_cell
from multiscale.micro import Path as LoadPath
from multiscale.micro.damage import Cavities, plane_damage, spheres

FILE = Path(__file__).parents[1] / "published.md"
AMPLITUDE = 1e-4  # m, of waves of 1 m under a contact modulus of 1 Pa: small slopes
HEAD = """\
# Published and exact values

`python workflows/manual/published.py` computes this table again; processor seconds of one thread,
with compiled kernels, on {day}.

| quantity | published or exact | here | difference, % | s | source |
| --- | --- | --- | --- | --- | --- |
"""

Row = tuple[str, float, float, str]


def main() -> None:
    """Compute all rows, and write their table."""
    lines = []
    for family in (line_wave, egg_box, cubic_spheres, grid_of_the_source):
        begin, rows = process_time(), list(family())
        seconds = (process_time() - begin) / len(rows)
        for what, exact, ours, source in rows:
            change = 100.0 * (ours / exact - 1.0)
            lines.append(
                f"| {what} | {exact:.5g} | {ours:.5g} | {change:.2g} | {seconds:.2g} | {source} |"
            )
    text = HEAD.format(day=datetime.now(UTC).date()) + "\n".join(lines) + "\n"
    FILE.write_text(text, encoding="utf-8")


def press(
    heights: np.ndarray, size: tuple[float, float], pressures: np.ndarray
) -> dict[str, np.ndarray]:
    """Press a conforming cell of unit contact modulus on a rigid flat."""
    cell = Cell(Surface(heights, size), 1.5, 24, youngs_modulus=0.91, poissons_ratio=0.3)
    response = solve_cell(cell, LoadPath(pressure=tuple(pressures)), keep_fields=True)
    highest = response["pressure"].values[0].max(axis=(1, 2)) / pressures
    return {
        "fraction": response["contact_fraction"].values[0],
        "gap": response["mean_gap"].values[0] / AMPLITUDE,
        "highest": highest,
    }


def line_wave() -> Iterator[Row]:
    """Yield the contact of a wave in one direction under shares s of its full contact pressure."""
    source = "Westergaard, J. Appl. Mech. 6 (1939) A49"
    n, s = 256, np.array([0.1, 0.25, 0.5, 0.75])
    x = np.arange(n) / n
    heights = AMPLITUDE * np.cos(2.0 * np.pi * x)[:, None] * np.ones(2)
    ours = press(heights, (1.0, 2.0 / n), s * np.pi * AMPLITUDE)
    for k, share in enumerate(s):
        exact = 2.0 / np.pi * np.arcsin(np.sqrt(share))
        yield f"line wave, p = {share:g} p*: contact fraction", exact, ours["fraction"][k], source
        exact = 1.0 - share + share * np.log(share)
        yield f"line wave, p = {share:g} p*: mean gap over amplitude", exact, ours["gap"][k], source
        exact = 2.0 / np.sqrt(share)
        what = f"line wave, p = {share:g} p*: largest over mean pressure"
        yield what, exact, ours["highest"][k], source


def egg_box() -> Iterator[Row]:
    """Yield the contact of a wave in both directions near full contact."""
    source = "Johnson, Greenwood and Higginson, Int. J. Mech. Sci. 27 (1985) 383"
    n, s = 128, np.array([0.9, 0.95])
    wave = np.cos(2.0 * np.pi * np.arange(n) / n)
    ours = press(AMPLITUDE * np.outer(wave, wave), (1.0, 1.0), s * np.sqrt(2.0) * np.pi * AMPLITUDE)
    for k, share in enumerate(s):
        exact = 1.0 - 3.0 / (2.0 * np.pi) * (1.0 - share)
        yield f"egg box, p = {share:g} p*: contact fraction", exact, ours["fraction"][k], source


def cubic_spheres() -> Iterator[Row]:
    """Yield the damage of planes through spheres of .3 of the edge of their cell, eq. (1)."""
    volume = Cavities((1.0, 1.0, 1.0), spheres([[0.5, 0.5, 0.5]], 0.3))
    damage = float(plane_damage(volume, (0.0, 0.0, 1.0)))
    yield "sphere of r = .3 a in a cube: damage of (100)", np.pi * 0.3**2, damage, "exact"


def grid_of_the_source() -> Iterator[Row]:
    """Yield the numbers of links of the tensegrity grid of the source."""
    grid = tensegrity_grid(16)
    for kind, name, count in ((0, "cables", 3072), (1, "bars", 1024)):
        ours = float(np.count_nonzero(grid.kind == kind))
        yield f"grid of 16 x 16 modules: {name}", count, ours, "the source, section 4"


if __name__ == "__main__":
    main()

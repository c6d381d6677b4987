"""Load a tensegrity grid until its cables go slack, then remove the load.

As the load factor rises from 0 to 1, a growing share of the cables goes slack, and the tensions
rise to several times the prestress (figure ``sorted_tensions``); a figure of the deformed grid
marks the slack cables. Then the load is removed suddenly: kinetic and elastic energy are drawn over
time, with their constant sum.

    python workflows/tensegrity_grid.py -o tensegrity [--quick]

writes in ``tensegrity/static`` and ``tensegrity/unloading`` a dataset, figures and a series for
ParaView in ``fields``. ``--quick`` takes 4 x 4 modules in place of 16 x 16.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from multiscale.pipeline import load_case, run_macro
from multiscale.pipeline.stages.cut_structures import LINKS
from multiscale.plotting import plot_deformed_links
from multiscale.plotting.figure import in_space

SCENES = Path(__file__).parent / "scenes"
PARTS = {"static": "tensegrity_grid", "unloading": "sudden_unloading"}
SCALE = 5.0
"""Factor of the displacements in the figures."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run both scenes, draw their figures and print their tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("tensegrity"))
    parser.add_argument("--quick", action="store_true", help="4 x 4 modules")
    arguments = parser.parse_args(argv)

    for part, name in PARTS.items():
        scene = load_case(SCENES / f"{name}.toml")
        if arguments.quick:
            scene = scene.quick()
        folder = arguments.out / part
        result = run_macro(scene, folder / "macro_result.nc")
        LINKS.draw(result, folder / "figures")
        draw = in_space(plot_deformed_links, result, scale=SCALE, size=(7.5, 5.5))
        draw(folder / "figures" / "deformed_links.png")
        sys.stdout.write("\n".join(LINKS.lines(result)) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

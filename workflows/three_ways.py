"""A rough structure solved in three ways: with a law, with cells at every point, and resolved.

*Sequential*: cells are pressed, a law is fitted, the structure is solved with it. *Concurrent*: a
cell is solved wherever the structure asks for a pressure. *Direct*: all roughness is in the model
of the structure. The scenes are a wave that is rough and a joint of two blocks under a tilted
platen; the longest wave of the roughness is 1/4 to 1/32 of their length.

    python workflows/three_ways.py -o three_ways [--quick]

leaves the dataset ``work_precision.nc``, its figure, error against run time of all ways, and the
table ``end_to_end.nc``, the rough wave with a law against the wave resolved, with the parts of the
error. It takes half an hour; ``--quick`` takes one ratio, coarse grids and few realisations.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from multiscale.io import make_folder, write_dataset
from multiscale.plotting import draw_work_precision
from multiscale.schema import END_TO_END, WORK_PRECISION
from multiscale.studies import EndToEndCase, end_to_end, three_ways
from multiscale.studies.end_to_end import CASES
from multiscale.studies.three_ways import EFFORTS, QUICK_EFFORTS

QUICK_CASES = (EndToEndCase(1 / 4, cells=3, realisations=3, points_per_wave=4),)


def main(argv: Sequence[str] | None = None) -> int:
    """Measure all ways, draw them and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("three_ways"))
    parser.add_argument(
        "--quick", action="store_true", help="one ratio, coarse grids, few realisations"
    )
    arguments = parser.parse_args(argv)
    out = make_folder(arguments.out)

    def say(line: str) -> None:
        sys.stdout.write(line + "\n")

    measured = three_ways(
        QUICK_EFFORTS if arguments.quick else EFFORTS,
        cells=2 if arguments.quick else 8,
        points_per_wave=4 if arguments.quick else 8,
        report=say,
    )
    write_dataset(measured, out / "work_precision.nc", WORK_PRECISION)
    draw_work_precision(measured, out / "work_precision.png")

    table = end_to_end(QUICK_CASES if arguments.quick else CASES, report=say)
    write_dataset(table, out / "end_to_end.nc", END_TO_END)
    for case in range(table.sizes["case"]):
        parts = zip(
            table["error_term"].values,
            100.0 * table["error_part"].values[case],
            100.0 * table["error_part_uncertainty"].values[case],
            strict=True,
        )
        say(
            f"scale ratio 1/{round(1.0 / float(table['scale_ratio'][case]))}: gap over rms height "
            f"{float(table['gap_law'][case]):.4f} with the law, "
            f"{float(table['gap_direct'][case]):.4f} resolved"
        )
        for name, part, uncertainty in parts:
            say(f"  {name}: {part:+.2f} +- {uncertainty:.2f} %")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

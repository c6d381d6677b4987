"""Table of all stiff and extreme cases: converged, refused and failed, by family.

    multiscale stability -o stability.nc
    python workflows/manual/stability.py stability.nc [FURTHER.nc ...]

from the root of a checkout writes ``workflows/stability.md`` from datasets of all cases.
"""

import argparse
from datetime import UTC, datetime
from pathlib import Path

import xarray as xr

from multiscale.bench.stability import read_cases, tabulate_stability
from multiscale.io import open_dataset
from multiscale.schema import STABILITY

FILE = Path(__file__).parents[1] / "stability.md"


def main() -> None:
    """Write the table of outcomes, and the sentence of every failed case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", help="datasets of multiscale stability")
    parts = [open_dataset(file, STABILITY) for file in parser.parse_args().files]
    outcomes = xr.concat(parts, "case", combine_attrs="override")
    head, rows = tabulate_stability(outcomes)
    count, total = outcomes.sizes["case"], len(read_cases())
    lines = [
        "# Stability",
        "",
        f"{count} of {total} stiff and extreme cases. Every answer is verified",
    ]
    lines += ["from its data, and every refusal has a reason."]
    lines += [f"(`multiscale stability`, {datetime.now(UTC).date()})", ""]
    lines += [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]
    failed = outcomes.isel(case=(outcomes["outcome"] == 0).to_numpy())
    if failed.sizes["case"]:
        lines += ["", "Failed cases:", ""]
    for k in range(failed.sizes["case"]):
        case = failed.isel(case=k)
        name, sentence = (case[key].item() for key in ("parameters", "sentence"))
        lines.append(f"- {case['family'].item()}, {name}: {sentence}")
    FILE.write_text("\n".join([*lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()

"""Vary the roughness of a bolted lap joint: stiffness, slip and loss of a cycle.

The shipped case ``bolted_lap``, with a lapped upper face, is run for several rms heights and Hurst
exponents of its ground face, on worker processes or the workers of a dask scheduler. The same
command continues a stopped run.

    python workflows/roughness_sweep.py -o roughness [--jobs N] [--dask ADDRESS] [--quick]

writes the case ``case.toml`` with its table ``[sweep]``, also for ``multiscale run``,
``sweep.nc``, the runs of the points in ``points``, and ``roughness_sweep.png``: the answers with
their 95 % intervals. ``--dask local`` starts a scheduler and workers on this machine; ``dask
scheduler`` and ``dask worker`` start others. ``--quick`` has two points with few cells and a given
friction instead of sheared cells.
"""

import argparse
import sys
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import tomli_w
from matplotlib.figure import Figure

from multiscale.executors import workers
from multiscale.io import make_folder
from multiscale.pipeline import load_sweep, run_sweep
from multiscale.pipeline.case import find_case
from multiscale.plotting import plot_sweep, sweep_ends
from multiscale.plotting.figure import save_figure

ANSWERS = ("joint_stiffness", "tangential_stiffness", "slipping_load", "cycle_energy")


def main(argv: Sequence[str] | None = None) -> int:
    """Run all points on workers, print the answers and draw them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("roughness"))
    parser.add_argument("--jobs", type=int, default=0, help="processes; 0 for one a core")
    parser.add_argument("--dask", help="address of a scheduler, or local")
    parser.add_argument("--quick", action="store_true", help="two points, few cells")
    arguments = parser.parse_args(argv)
    out = make_folder(arguments.out)

    file = out / "roughness.toml"
    file.write_text(tomli_w.dumps(make_case(arguments.quick)), encoding="utf-8")
    sweep = load_sweep(file)
    sweep = sweep.quick() if arguments.quick else sweep
    with cluster(arguments.dask) as address, workers(arguments.jobs, address) as executor:
        result = run_sweep(sweep, out, executor=executor, progress=say)

    ends = {name: sweep_ends(result, name)["value"].values for name in ANSWERS}
    table = result[list(result["parameter"].values)].to_dataframe().assign(**ends)
    sys.stdout.write(f"{table.to_string()}\n")
    figure = Figure(figsize=(16.0, 3.6), layout="constrained")
    for name, ax in zip(ANSWERS, figure.subplots(1, len(ANSWERS)), strict=True):
        plot_sweep(result, name, ax=ax)
    save_figure(figure, out / "roughness_sweep.png")
    return 0


def make_case(quick: bool) -> dict[str, Any]:
    """Return the shipped case with one lapped face, and with the values of the other face."""
    case = tomllib.loads(find_case("bolted_lap").read_text(encoding="utf-8"))
    del case["body_2"]["surface"]
    if quick:
        del case["micro"]["shear"], case["law"]
        case["interface"] = {"friction": 0.2, "stiffness_ratio": 0.82}
    heights = ["0.3 um", "0.8 um"] if quick else ["0.2 um", "0.4 um", "0.8 um", "1.6 um"]
    surface = {"rms_height": heights, "hurst_exponent": [0.8] if quick else [0.5, 0.8]}
    case["statics"]["preloads"] = ["50 MPa"]  # under the washers
    return case | {"title": "Roughness of a lap joint", "sweep": {"body_1": {"surface": surface}}}


@contextmanager
def cluster(address: str | None) -> Iterator[str | None]:
    """Yield an address, of workers on this machine where it is ``local``."""
    if address != "local":
        yield address
        return
    from distributed import LocalCluster

    with LocalCluster(threads_per_worker=1, dashboard_address=None) as started:
        yield started.scheduler_address


def say(finished: int) -> None:
    """Report the number of finished points."""
    sys.stderr.write(f"{finished} points are finished\n")


if __name__ == "__main__":
    raise SystemExit(main())

"""Compute law, stiffness, slip and loss of a bolted lap joint of two measured surfaces.

Windows of the two maps are cells, which are pressed; some of them are also sheared. A lap joint of
two plates under a bolt has the law of the cells, and is sheared to and fro. Without ``--surfaces``
the script writes two maps of ground steel in the format SDF of ISO 25178-71.

    python workflows/surfaces_to_joint.py -o lap [--surfaces FILE FILE] [--quick]

writes the two maps, the case ``case.toml``, the datasets of its run in ``run``, and
``surfaces_to_joint.png``: a cell in contact, the law, and the loop of force and displacement with
its bands. ``--quick`` is coarser. Maps may have any format that SurfaceTopography reads.
"""

import argparse
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tomli_w
from matplotlib.figure import Figure

from multiscale import plotting
from multiscale.io import make_folder, open_dataset
from multiscale.pipeline import load_case, run
from multiscale.pipeline.case import find_case
from multiscale.plotting.figure import save_figure
from multiscale.schema import FIELDS
from multiscale.surfaces import self_affine


def main(argv: Sequence[str] | None = None) -> int:
    """Solve the joint of the maps, and draw its steps."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("lap"))
    parser.add_argument("--surfaces", type=Path, nargs=2, help="maps of both faces")
    parser.add_argument("--quick", action="store_true", help="coarser cells, few realisations")
    arguments = parser.parse_args(argv)
    out = make_folder(arguments.out)

    maps = arguments.surfaces or [write_map(out / f"ground_{k}.sdf", seed=k) for k in (1, 2)]
    case = load_case(write_case(out / "case.toml", maps))
    results = run(case.quick() if arguments.quick else case, out / "run")

    law, joint = results["interface_law"], results["macro_result"]
    normal, tangential = (
        1e-12 * float(joint[f"{name}_stiffness"][0]) for name in ("joint", "tangential")
    )
    low, high = 1e3 * joint["cycle_energy_mean_law"].values[:, -1]
    sys.stdout.write(
        f"friction {float(law['shear_friction']):.3f}, tangential over normal stiffness "
        f"{float(law['shear_stiffness_ratio'].mean()):.3f}\n"
        f"normal stiffness of the joint {normal:.3g} MPa/µm, tangential {tangential:.3g} MPa/µm\n"
        f"loss of a cycle {1e3 * float(joint['cycle_energy'][-1]):.3g} mJ, 95 % interval of the "
        f"mean law {f'{low:.3g} ... {high:.3g} mJ' if low < high else 'unknown'}\n"
    )
    figure = Figure(figsize=(13.0, 3.8), layout="constrained")
    contact, gap, loop = figure.subplots(1, 3)
    fields = open_dataset(out / "run" / "fields" / "fields.nc", FIELDS)
    plotting.plot_contact_map(fields, step=-1, ax=contact)
    plotting.plot_gap_law(results["micro_response"], law, ax=gap)
    plotting.plot_hysteresis(joint, ax=loop)
    save_figure(figure, out / "surfaces_to_joint.png")
    return 0


def write_case(file: Path, maps: Sequence[Path]) -> Path:
    """Write the shipped case of a lap joint, with measured faces and few cells."""
    case = tomllib.loads(find_case("bolted_lap").read_text(encoding="utf-8"))
    for body, path in zip(("body_1", "body_2"), maps, strict=True):
        case[body]["surface"] = {"file": str(path.resolve()), "short_cutoff": "100 um"}
    case["micro"]["shear"] |= {"pressures": ["20 MPa"], "realisations": 2}
    case["statics"]["preloads"] = ["50 MPa"]  # under the washers
    case["title"] = "Lap joint of two measured surfaces"
    file.write_text(tomli_w.dumps(case), encoding="utf-8")
    return file


def write_map(file: Path, *, seed: int) -> Path:
    """Write a tilted map of ground steel, 3 mm by 3 mm, in the format of an instrument."""
    band = {"hurst_exponent": 0.8, "long_cutoff": 2e-4, "short_cutoff": 1e-4}
    surface = self_affine((256, 256), (3e-3, 3e-3), seed, rms_height=0.4e-6, **band)
    heights = 1e6 * surface.heights + 1e-3 * seed * np.arange(256)[:, None]  # um
    head = ["aISO-1.0", "ManufacID = multiscale", "NumPoints = 256", "NumProfiles = 256"]
    head += [*(f"{axis}scale = {surface.spacing[0]}" for axis in "XY"), "Zscale = 1.0E-6"]
    head += ["Zresolution = 1.0E-9", "Compression = 0", "DataType = 7", "CheckType = 0", "*"]
    rows = [" ".join(f"{height:.5f}" for height in row) for row in heights.T]
    file.write_text("\n".join([*head, *rows, "*", "*"]), encoding="ascii")
    return file


if __name__ == "__main__":
    raise SystemExit(main())

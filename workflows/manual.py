"""The figures and the tables of keys of the manual, made anew.

Shows the chain on one surface (heights, contact, law with its band, stiffness of the joint), and
three structures: slack cables of a tensegrity grid, where a rough joint sticks and slips, and the
forces in a pile of grains. The tables of the keys come from the models that read case files.

    python workflows/manual.py -o . [--quick]

from the root of a checkout writes ``README.md``, ``workflows/figures/*.png`` and the datasets in
``results``. It takes some minutes; ``--quick`` takes coarse cells, few modules and grains.
"""

import argparse
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

from multiscale import plotting
from multiscale.io import make_folder, open_dataset, open_run, read_text, write_bytes
from multiscale.pipeline import load_case, load_scene, run, run_scene
from multiscale.pipeline.key_tables import key_tables
from multiscale.schema import FIELDS

ROOT = Path(__file__).parents[1]
SCENES = ("tensegrity_grid", "rough_blocks", "deposit")
BEGIN, END = "<!-- keys: written by workflows/manual.py -->\n", "\n<!-- end of keys -->"


def main(argv: Sequence[str] | None = None) -> int:
    """Run a case and three scenes, draw them and write the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--out", type=Path, default=Path("manual"))
    parser.add_argument("--quick", action="store_true", help="coarse cells, few modules and grains")
    arguments = parser.parse_args(argv)
    figures = make_folder(arguments.out / "workflows" / "figures")
    results = arguments.out / "results"

    case = load_case("ground_steel")
    run(case.quick() if arguments.quick else case, results)
    save_small(draw_chain(results), figures / "chain.png")
    found = []
    for name in SCENES:
        scene = load_scene(ROOT / "workflows" / "scenes" / f"{name}.toml")
        law = results / "interface_law.nc" if scene.joint else None
        file = results / name / "macro_result.nc"
        found.append(run_scene(scene.quick() if arguments.quick else scene, file, law=law))
    save_small(draw_structures(found), figures / "structures.png")
    readme = renew(read_text(ROOT / "README.md"))
    write_bytes(arguments.out / "README.md", readme.encode())
    return 0


def save_small(figure: Figure, file: Path) -> None:
    """Write a figure in 256 colours."""
    drawn, reduced = BytesIO(), BytesIO()
    figure.savefig(drawn, dpi=80)
    Image.open(drawn).convert("RGB").quantize(256).save(reduced, "png", optimize=True)
    write_bytes(file, reduced.getvalue())


def renew(readme: str) -> str:
    """Put the tables of keys between their marks."""
    before, rest = readme.split(BEGIN)
    return f"{before}{BEGIN}{key_tables()}{END}{rest.split(END)[1]}"


def draw_chain(results: Path) -> Figure:
    """Draw a run from its surface to its joint."""
    tree = open_run(results)
    response, law, joint = (tree[name].to_dataset() for name in tree)
    fields = open_dataset(results / "fields" / "fields.nc", FIELDS)
    figure = Figure(figsize=(14.0, 3.4), layout="constrained")
    axes = figure.subplots(1, 4)
    plotting.plot_surface(fields, ax=axes[0]).set_title("1 surface")
    plotting.plot_contact_map(fields, step=-1, ax=axes[1]).set_title("2 contact of a cell")
    plotting.plot_gap_law(response, law, ax=axes[2]).set_title("3 interface law")
    plotting.plot_joint_stiffness(joint, ax=axes[3]).set_title("4 joint")
    return figure


def draw_structures(found: Sequence) -> Figure:
    """Draw the structures in the order of the scenes."""
    figure = Figure(figsize=(14.0, 4.0), layout="constrained")
    plotting.plot_deformed_links(found[0], ax=figure.add_subplot(131, projection="3d"), scale=5.0)
    plotting.plot_joint_plan(found[1], ax=figure.add_subplot(132))
    plotting.plot_force_network(found[2], ax=figure.add_subplot(133))
    return figure


if __name__ == "__main__":
    raise SystemExit(main())

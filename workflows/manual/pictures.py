"""Draw the pictures of the manual.

``joint.png``, the first picture of the README, has zones of stick and slip of ``bolted_lap``, its
loop, and its stiffness and loss against preload and amplitude. ``chain.png`` shows a case from
its surface to its joint; ``structures.png`` has slack cables of a tensegrity grid, zones of stick
and slip, and the forces in a pile of grains. The other pictures are in the gallery.

    python workflows/manual/pictures.py [NAME ...] -o . [--quick]

from the root of a checkout writes ``workflows/figures/*.png`` and, in ``results``, the datasets of
the named cases, scenes and scripts (of all, without a name), and prints the processor time of each.
``--quick`` is coarser.
"""

import argparse
import os
import runpy
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from io import BytesIO
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from multiscale import macro, plotting
from multiscale.bench import FAMILIES, bench
from multiscale.bench.answers import WAVE_SCENES
from multiscale.io import make_folder, open_dataset, open_run, write_bytes
from multiscale.macro import links
from multiscale.pipeline import load_case, run, run_macro
from multiscale.plotting.figure import save_figure
from multiscale.schema import FIELDS
from multiscale.upscaling import fitted_laws

WORKFLOWS = Path(__file__).parents[1]
SHOWN = {
    "ground_steel": lambda run, ax: plotting.plot_joint_stiffness(run["macro_result"], ax=ax),
    "ground_steel_plastic": lambda run, ax: plotting.plot_unloading(
        run["micro_response"], run["interface_law"], ax=ax
    ),
    "coated_steel": lambda run, ax: plotting.plot_area_law(
        run["micro_response"], run["interface_law"], ax=ax
    ),
    "bolted_lap": lambda run, ax: plotting.plot_hysteresis(run["macro_result"], ax=ax),
    "mesh_cell": lambda run, ax: plotting.plot_joint_stiffness(run["macro_result"], ax=ax),
    "overhang_cell": lambda run, ax: plotting.plot_contact_map(run["fields"], step=-1, ax=ax),
    "road_texture": lambda run, ax: plotting.plot_area_law(
        run["micro_response"], run["interface_law"], ax=ax
    ),
    "seal": lambda run, ax: plotting.plot_flow_channels(run["fields"], ax=ax),
    "porous_bracket": lambda run, ax: plotting.plot_body_stress(run["macro_result"], ax=ax),
    "notched_concrete": lambda run, ax: plotting.plot_cracked_load(run["cracked_body"], ax=ax),
    "holed_strip": lambda run, ax: plotting.plot_element_field(
        run["fatigue_life"], "equivalent_amplitude", near=False, ax=ax
    ),
    "brake_reuss": lambda run, ax: draw_beam(run["vibration"], ax),
    "tyre_on_road": lambda run, ax: plotting.plot_lines(
        run["macro_result"], "braking_force", by="temperature", xscale="log", ax=ax
    ),
    "tensegrity_grid": plotting.plot_sorted_tensions,
    "tensegrity_substructures": plotting.plot_deformed_links,
    "equivalent_plate": lambda result, ax: draw_plates(ax),
    "guyed_mast": plotting.plot_deformed_links,
    "cable_net": plotting.plot_deformed_links,
    "shallow_dome": plotting.plot_past_limit,
    "sudden_unloading": plotting.plot_energies,
    "rough_blocks": plotting.plot_hysteresis,
    "lap_joint": plotting.plot_joint_plan,
    "bolted_cover": lambda result, ax: plotting.load_pictures(result)["contact_zones_0"](ax=ax),
    "deposit": plotting.plot_force_network,
    "silo": plotting.plot_force_network,
    "column_collapse": plotting.plot_force_network,
    "shear_cell": plotting.plot_force_network,
    "biaxial": plotting.plot_biaxial_curve,
    "damage_to_joint": plotting.plot_woehler,
    "ploughing": lambda response, ax: plotting.plot_lines(
        response, "effective_friction", by="nominal_pressure", ax=ax
    ),
    "surfaces_to_joint": plotting.plot_hysteresis,
    "measured_stiffness": plotting.plot_joint_stiffness,
    "measured_joint": lambda law, ax: [
        single_law.plot(ax=ax) for single_law in fitted_laws(law, range(40))
    ],
    "roughness_sweep": partial(plotting.plot_sweep, answer="slipping_load"),
    "three_ways": lambda runs, ax: plotting.plot_work_precision(
        runs, scene="rough wave", ax=ax
    ).legend(fontsize="small"),
    "error_against_time": lambda runs, ax: draw_cells(runs, ax=ax),
    "error_of_the_chain": lambda runs, ax: draw_chain_errors(runs, ax=ax),
}
PUBLISHED = {1e-7: 0.0873, 2.43e-6: 0.1636, 8.94e-6: 0.615, 6.99e-5: 3.063}
"""Damping of the first bending mode of the Brake-Reuss beam, % of critical, at modal amplitudes,
kg^1/2 m: J. H. Porter and M. R. W. Brake, Mech. Syst. Signal Process. 192 (2023) 110210."""

LEFT = {
    "damage_to_joint": "woehler.nc",
    "ploughing": "sliding_response.nc",
    "surfaces_to_joint": "run/macro_result.nc",
    "measured_stiffness": "macro_result.nc",
    "measured_joint": "interface_law.nc",
    "roughness_sweep": "sweep.nc",
    "three_ways": "work_precision.nc",
}
"""Datasets of scripts."""

IN_SPACE = {"porous_bracket"} | {
    name for name, plot in SHOWN.items() if plot is plotting.plot_deformed_links
}
"""Pictures on axes in space."""

STRUCTURES = ("tensegrity_grid", "rough_blocks", "deposit")

BENCHED = tuple(f"bench_{family}" for family in FAMILIES if family not in ("micro", "chain"))
"""Families of ``bench`` in their quick form, with the figure of the command."""


def main(argv: Sequence[str] | None = None) -> int:
    """Solve cases and scenes, and draw them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", default=[*SHOWN, *BENCHED], help="of figures")
    parser.add_argument("-o", "--out", type=Path, default=Path("manual"))
    parser.add_argument("--quick", action="store_true", help="coarse cells, few modules and grains")
    arguments = parser.parse_args(argv)
    figures = make_folder(arguments.out / "workflows" / "figures")
    results, solved = arguments.out / "results", {}
    for name in arguments.names:
        start = sum(os.times()[:4])  # of this process and of its workers
        if name in BENCHED:
            runs = bench(name.removeprefix("bench_"), quick=True)
            reduce_colours(plotting.draw_work_precision(runs, figures / f"{name}.png"), colours=16)
            continue
        solved[name] = solve(name, results, quick=arguments.quick)
        sys.stdout.write(f"{name}: {sum(os.times()[:4]) - start:.0f} s\n")
        sys.stdout.flush()
        figure = Figure(figsize=(4.8, 3.6), layout="constrained")
        space = name in IN_SPACE
        SHOWN[name](solved[name], ax=figure.add_subplot(projection="3d" if space else None))
        save_small(figure, figures / f"{name}.png", colours=32)
    if "ground_steel" in solved:
        save_small(draw_chain(solved["ground_steel"]), figures / "chain.png", colours=96)
    if "bolted_lap" in solved:
        answers = draw_answers(solved["bolted_lap"]["macro_result"])
        save_small(answers, figures / "joint.png", colours=64)
    if set(STRUCTURES) <= set(solved):
        save_small(
            draw_structures(*(solved[name] for name in STRUCTURES)), figures / "structures.png"
        )
    return 0


def solve(name: str, results: Path, *, quick: bool) -> "xr.Dataset | Mapping[str, xr.Dataset]":
    """Return the dataset of a scene or script, or the datasets of a case by their names."""
    scene, out = WORKFLOWS / "scenes" / f"{name}.toml", results / name
    if name == "error_against_time":
        return bench("micro", quick=True)
    if name == "error_of_the_chain":
        return bench("chain", quick=quick)
    if name in LEFT:
        main = runpy.run_path(str(WORKFLOWS / f"{name}.py"))["main"]
        main(["-o", str(out), *(["--quick"] if quick else [])])
        return xr.load_dataset(out / LEFT[name])
    if scene.is_file():
        settings = load_case(scene)
        settings = settings.quick() if quick else settings
        return run_macro(settings, out / "macro_result.nc")
    case = load_case(name)
    run(case.quick() if quick else case, out)
    datasets = {key: node.to_dataset() for key, node in open_run(out).items()}
    fields = out / "fields" / "fields.nc"
    return datasets | ({"fields": open_dataset(fields, FIELDS)} if fields.is_file() else {})


def save_small(figure: Figure, file: Path, *, colours: int = 128) -> None:
    """Write a figure as reports do, smaller and in few colours, with both ends of colour maps."""
    reduce_colours(save_figure(figure, file), colours=colours)


def reduce_colours(file: Path, *, colours: int) -> None:
    """Write a picture again, with half of its points each way and few colours."""
    drawn, reduced = Image.open(file).convert("RGB"), BytesIO()
    small = drawn.reduce(2).quantize(colours, Image.Quantize.MAXCOVERAGE)
    small.save(reduced, "png", optimize=True)
    write_bytes(file, reduced.getvalue())


def draw_cells(runs: xr.Dataset, ax: Axes) -> None:
    """Draw the error of a rough cell against processor time, next to the boundary-element codes."""
    plotting.plot_work_precision(runs.assign(wall_time=runs["cpu_time"]), ax=ax)
    ax.set(xlabel="processor time (s)", ylabel="error of the mean gap over rms height")
    ax.legend(fontsize="small")


def draw_plates(ax: Axes, counts: Sequence[int] = (4, 8, 16, 32)) -> None:
    """Draw the error of plates equivalent to grids against the number of modules across."""
    errors = np.array([plate_errors(n) for n in counts])
    for name, values in zip(
        ("displacement", "first frequency"), errors.transpose(1, 2, 0), strict=True
    ):
        marker = "o" if name == "displacement" else "s"
        for state, error, fill in zip(("taut", "slack"), values, ("full", "none"), strict=True):
            ax.loglog(counts, error, f"{marker}-", label=f"{name}, {state}", fillstyle=fill)
    ax.set(xlabel="modules across", ylabel="error of the equivalent plate")
    ax.set_xticks(counts, map(str, counts))
    ax.minorticks_off()
    ax.legend(fontsize="small")


def plate_errors(n: int) -> list[np.ndarray]:
    """Return errors of displacement and first frequency of n modules, taut and with slack cables.

    Tensions under a load rise with n^2, and with n^4 relative to a buckling load. Prestress and
    load are scaled to a constant share of slack cables and ratio of membrane to bending forces.
    """
    options = {"prestress": 2550.0 * (16.0 / n) ** 2, "nodal_load": 40.0 * (16.0 / n) ** 4}
    factors, mass = [0.1, 1.0], 2.0
    grid, cell = (macro.tensegrity_grid(k, **options) for k in (n, 1))
    plate = links.EquivalentPlate(grid, links.plate_cell(cell, (1.0, 1.0)), (n, n))
    rest = links.natural_frequencies(grid, macro.solve_static(grid, factors), mass, count=1)
    result = links.compare_with_links(links.solve_plate(plate, factors, mass=mass), rest)
    frequency = np.abs(result["first_frequency"] / result["links_frequency"] - 1.0)
    return [result["plate_error"].to_numpy(), frequency.to_numpy()]


def draw_chain_errors(runs: xr.Dataset, ax: Axes) -> None:
    """Draw the errors of answers of the whole chain against processor time, by closed forms."""
    for scene in WAVE_SCENES:
        ladder = runs.isel(run=runs["scene"].values == scene)
        ax.loglog(ladder["cpu_time"], 100.0 * ladder["error"], "o-", label=scene)
    ax.set(xlabel="processor time from surface to answer (s)", ylabel="error (%)")
    ax.legend(fontsize="small")


def draw_beam(result: xr.Dataset, ax: Axes) -> None:
    """Draw the damping of the first mode of the Brake-Reuss beam, and the published damping."""
    plotting.plot_backbone(result, quantity="damping", ax=ax)
    first = result.isel(step=0)
    lever = float(first["largest_displacement"] / first["modal_amplitude"])
    x = [1e6 * lever * amplitude for amplitude in PUBLISHED]  # um
    ax.plot(x, list(PUBLISHED.values()), "kx", label="Porter and Brake")
    ax.set_yscale("log")
    ax.legend(fontsize="small")


def draw_answers(joint: xr.Dataset) -> Figure:
    """Draw zones of stick and slip, the loop, and cycles against preload and amplitude."""
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    axes = figure.subplot_mosaic(
        [["contact_zones", "hysteresis"], ["secant_stiffness", "cycle_loss"]]
    )
    draw = plotting.joint_pictures(joint)
    for name, ax in axes.items():
        draw[name](ax=ax)
    return figure


def draw_chain(run: "Mapping[str, xr.Dataset]") -> Figure:
    """Draw a run from its surface to its joint."""
    figure = Figure(figsize=(14.0, 3.4), layout="constrained")
    axes = figure.subplots(1, 4)
    plotting.plot_surface(run["fields"], ax=axes[0]).set_title("1 surface")
    plotting.plot_contact_map(run["fields"], step=-1, ax=axes[1]).set_title("2 contact of a cell")
    gap_law = plotting.plot_gap_law(run["micro_response"], run["interface_law"], ax=axes[2])
    gap_law.set_title("3 interface law")
    plotting.plot_joint_stiffness(run["macro_result"], ax=axes[3]).set_title("4 joint")
    return figure


def draw_structures(grid: xr.Dataset, joint: xr.Dataset, grains: xr.Dataset) -> Figure:
    """Draw slack cables, zones of stick and slip, and a force network."""
    figure = Figure(figsize=(14.0, 4.0), layout="constrained")
    plotting.plot_deformed_links(grid, ax=figure.add_subplot(131, projection="3d"), scale=5.0)
    plotting.plot_joint_plan(joint, ax=figure.add_subplot(132))
    plotting.plot_force_network(grains, ax=figure.add_subplot(133))
    return figure


if __name__ == "__main__":
    raise SystemExit(main())

"""Stages: a volume of a solid with pores and cracks, and cracks that grow until they cut it."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np

from multiscale.io.images import VoxelImage
from multiscale.micro.damage.cracks import grow_volumes
from multiscale.micro.damage.rve import measure_volume, represent
from multiscale.micro.damage.sections import Volume, section_normals
from multiscale.micro.ensemble import run_realisations
from multiscale.needs import Choice, Needs
from multiscale.pipeline.plans.case_knobs import volume_knobs
from multiscale.pipeline.showing import Rows, Table, View, format_mean
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.tables.rve_settings import RveSettings
from multiscale.pipeline.tables.settings import Case
from multiscale.plotting import rve_figures
from multiscale.plotting.figure import in_space, new_figure, on_axes, save_figure
from multiscale.schema import RVE, RVE_VOLUMES, VOLUME_GROWTH, Dataset, PlainDataset
from multiscale.units import readable

FOLDER = "volumes"

FEWEST_ACROSS = 6.0
"""Voxels across a pore below which the stiffness depends on the voxels by some per cent."""

FLATTEST = 3.0  # ratio of the edges of a voxel above which a mistake in its size is likely

BYTES, SECONDS = 650.0, 6e-5
"""Memory and time of a voxel, with all sides, and seconds of a section of closed forms."""

SECTION_SECONDS = 3e-4

TABLE = Table(
    (
        "place",
        *("damage", "damage:one_part"),
        *("modulus", "modulus:mean_law", "modulus:one_part", "modulus:sides"),
    ),
    {
        "place": "direction",
        "damage": "damage of the worst section",
        "damage:one_part": "of one volume, 95 %",
        "modulus": "E",
        "modulus:mean_law": "of the material, 95 %",
        "modulus:one_part": "of one volume, 95 %",
        "modulus:sides": "traction ... displacement sides",
    },
    along=("direction",),
)


def measure_case(rve: RveSettings, job: Job) -> Dataset:
    """Measure all volumes of the settings that are not finished yet, and average all."""
    volumes = [*rve.jobs()]
    measure = partial(
        measure_volume,
        youngs_modulus=rve.youngs_modulus,
        poissons_ratio=rve.poissons_ratio,
        level=rve.level,
        sections=rve.sections,
        slab=rve.slab,
    )
    identity = rve.checksum(exclude={"accept"})
    measured = run_realisations(
        _measure,
        [(measure, volume, rve.voxels_of(volume), share) for share, volume in volumes],
        executor=job.executor,
        folder=job.out / FOLDER / identity[:12],
        sparing=job.sparing,
        identity=identity,
        progress=lambda finished: job.progress(finished, len(volumes), "volumes"),
        name="volume",
        schema=RVE_VOLUMES,
    )
    image = volumes[0][1].image(rve.voxels)
    moduli = rve.youngs_modulus, rve.poissons_ratio
    result = represent(measured, image, *moduli, level=rve.level)
    porosity = result["porosity"].to_numpy()[result["share"].to_numpy() == 1.0]
    result = result.assign_attrs(
        accept=rve.accept,
        limits="; ".join(rve.limits(float(porosity.mean()))),
        counts=", ".join(f"{count:.6g} {name}" for name, count in rve.counts.items()),
    )
    return result.assign_attrs(cautions="\n".join(_cautions(rve, image, result, measured)))


def _measure(
    measure: Callable[..., Dataset], volume: Volume, voxels: int, share: float
) -> PlainDataset:
    return RVE_VOLUMES.plain(measure(volume, voxels=voxels, share=share))


def _cautions(
    rve: RveSettings, image: VoxelImage, result: Dataset, measured: Dataset
) -> Iterator[str]:
    if ended := measured.attrs.get("ended"):
        yield ended.replace("\n", "; ")
    whole = rve.image.read() if rve.image is not None else image
    if floating := int(np.count_nonzero(whole.floating)):
        volume = floating * float(np.prod(whole.spacing))
        share = 100.0 * floating / np.count_nonzero(~whole.void)
        treated = "sections in closed form still count it"
        yield (
            f"solid of {1e18 * volume:.3g} µm³, {share:.2g} % of it, is not connected to the rest "
            f"and carries no load; "
            + ("it is treated as void" if rve.image is not None else treated)
        )
    yield from filter(None, [result.attrs["limits"]])
    for name, count in rve.counts.items() if rve.recipe else ():
        few = [share for share in rve.parts if share**3 * count < 1.0]
        if few:
            yield (
                f"volumes of {few[-1]:g} of the size and less in the size study contain fewer than "
                f"one of the {name} on average; their rows do not represent the material"
            )
    edges = np.array(image.spacing)
    across = rve.smallest / edges.max()
    if across < FEWEST_ACROSS:
        yield (
            f"pores are {across:.2g} voxels across, and the stiffness needs {FEWEST_ACROSS:g} or "
            "more; give more voxels"
        )
    if edges.max() > FLATTEST * edges.min():
        size = " x ".join(readable(f"{edge:.3g} m") for edge in edges)
        yield f"voxels measure {size}: check voxel_size in [rve.image]"
    if not np.isfinite(result["scatter"]).all():
        yield (
            "a single volume has no scatter, so intervals are unknown; give several volumes, or "
            "parts of half its size or less"
        )


def is_representative(rve: Dataset) -> str:
    """Report distance of the bounds and scatter, and whether the volume is representative."""
    if limits := rve.attrs.get("limits"):
        return f"The volume is not representative: {limits}."
    accept = float(rve.attrs["accept"])
    gap = float(rve["modulus_error"].sel(rve_error="sides").max())
    scatter = float(rve["scatter"].max())
    if np.isnan(gap) or np.isnan(scatter):
        return (
            "It is unknown whether the volume is representative, as there are no bounds by "
            "traction and displacement sides, or no scatter."
        )
    differ = (
        f"{100.0 * gap:.2g} % from periodic sides, and volumes scatter by {100.0 * scatter:.2g} %"
    )
    if max(gap, scatter) <= accept:
        return (
            f"Traction and displacement sides differ by at most {differ}: the volume is "
            f"representative within {100.0 * accept:g} %."
        )
    return (
        f"Traction and displacement sides differ by up to {differ}: the volume is not "
        f"representative within {100.0 * accept:g} %; intervals include this, and a larger "
        f"volume narrows them."
    )


def _axes(rve: Dataset) -> dict[str, int]:
    """Numbers of the normals along the edges."""
    normals = np.abs(rve["normal"].to_numpy())
    return {name: int(np.argmax(normals[:, k])) for k, name in enumerate("xyz")}


def _tabulate(rve: Dataset) -> Rows:
    """Head and rows of damage and modulus along the edges and extreme directions."""
    whole = rve["share"].to_numpy() == 1.0
    bounds = rve["apparent_modulus"].to_numpy()[whole].mean(axis=0)[[0, 2]]
    softest, worst = (int(np.argmin(rve["modulus"].values)), int(np.argmax(rve["damage"].values)))
    places = {**_axes(rve), "softest": softest, "most damaged": worst}
    names = [
        name
        if len(name) == 1
        else f"{name} ({', '.join(f'{0.0 if abs(n) < 5e-3 else n:.2f}' for n in normal)})"
        for name, normal in zip(places, rve["normal"].to_numpy()[[*places.values()]], strict=True)
    ]
    shown = rve.assign(modulus_sides=(("limit", "direction"), bounds))
    shown = shown.isel(direction=[*places.values()]).assign(place=("direction", names))
    return TABLE.rows(shown)


def _sizes(rve: Dataset) -> Rows:
    """Head and rows of the size study."""
    counts = [part.split() for part in rve.attrs.get("counts", "").split(", ") if part]

    def inclusions(size: float) -> str:
        return ", ".join(f"{size**3 * float(n):.2g} {name}" for n, name in counts)

    E = 1e-9 * rve["apparent_modulus"].to_numpy().mean(axis=-1)
    means = {
        "porosity (%)": 100.0 * rve["porosity"].to_numpy(),
        "worst section": rve["largest_damage"].to_numpy().max(axis=1),
        **{f"E, {sides} (GPa)": E[:, k] for k, sides in enumerate(rve["sides"].values)},
    }
    edge = float(np.prod(rve["box_size"].to_numpy())) ** (1.0 / 3.0)
    return _by_size(rve, edge, means, {"inclusions": inclusions} if counts else {})


def _by_size(
    volumes: Dataset,
    edge: float,
    means: Mapping[str, np.ndarray],
    further: Mapping[str, Callable[[float], str]] = MappingProxyType({}),
) -> Rows:
    """Head and rows of means and standard deviations over volumes of each size."""
    share, rows = volumes["share"].to_numpy(), []
    for size in np.unique(share):
        same = share == size
        known = (format_mean(values[same]) for values in means.values())
        others = (write(size) for write in further.values())
        rows.append((readable(f"{size * edge:.4g} m"), f"{same.sum()}", *others, *known))
    return ("edge", "volumes", *further, *means), rows


def _causes(rve: Dataset) -> str:
    half = 100.0 * rve["modulus_error"].max("direction").to_numpy()
    causes = [
        f"{name} {value:.2g} %" if np.isfinite(value) else f"{name} unknown"
        for name, value in zip(rve["rve_error"].values, half, strict=True)
    ]
    return f"Half-widths of the 95 % interval of the material, at most: {', '.join(causes)}."


def _facts(rve: Dataset) -> list[str]:
    whole = rve["share"].to_numpy() == 1.0
    porosity = format_mean(100.0 * rve["porosity"].to_numpy()[whole])
    size = " x ".join(readable(f"{edge:.4g} m") for edge in rve["box_size"].to_numpy())
    source = rve.attrs["spread"]
    return [
        f"{whole.sum()} volume(s) of {size}, porosity {porosity} %.",
        is_representative(rve),
        _causes(rve) + (f" The scatter comes from {source}." if source else ""),
        "Damage is geometric, eq (1): the stiffness is E (1 - D) only for pores that extend "
        "through the volume along the direction.",
    ]


def _answer(rve: Dataset) -> Iterator[str]:
    E = rve["modulus"].to_numpy()
    loss = 100.0 * (1.0 - E / rve.attrs["youngs_modulus"])
    low, high = 1e-9 * E.min(), 1e-9 * E.max()
    yield from View(rve).sentences(
        rve.isel(direction=int(np.argmin(E))),
        "Young's modulus lies between {low} and {high} GPa with the direction, {least} to {most} % "
        "below the solid (softest direction: {modulus:mean_law}, 95 %), and the worst plane "
        "section has {lost} % less area.",
        low=f"{low:.4g}",
        high=f"{high:.4g}",
        least=f"{loss.min():.3g}",
        most=f"{loss.max():.3g}",
        lost=f"{100.0 * float(rve['damage'].max()):.3g}",
    )
    yield is_representative(rve)


def _sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    rve = datasets[RVE.name]
    figures: dict[str, Callable[[Path], Path]] = {
        "rve": in_space(rve_figures.plot_rve, rve),
        "stiffness_surface": in_space(rve_figures.plot_modulus_surface, rve),
        "damage_sphere": in_space(rve_figures.plot_rve_damage, rve),
        "size_study": partial(_draw_study, rve),
    }

    yield Section(
        "Representative volume", (), *_tabulate(rve), figures=figures, remarks=_facts(rve)
    )
    caption = ["Means over volumes, and for stiffnesses over directions, ± standard deviation."]
    yield Section("Size study", caption, *_sizes(rve))


def _draw_study(rve: Dataset, file: Path) -> Path:
    figure = new_figure(5.2, 5.6)
    rve_figures.plot_size_study(rve, figure)
    return save_figure(figure, file)


def _compared(rve: Dataset) -> Dataset:
    """Return moduli along the edges with their intervals, the largest damage and the porosity."""
    whole = rve["share"].to_numpy() == 1.0
    values = {
        "largest_damage": rve["damage"].max("direction"),
        "porosity": rve["porosity"].isel(realisation=whole).mean("realisation"),
    }
    for name, k in _axes(rve).items():
        for kind in ("", "_mean_law", "_one_part"):
            values[f"modulus_{name}{kind}"] = rve[f"modulus{kind}"].isel(direction=k, drop=True)
    return rve[[]].assign(values)


def _needs(case: Case) -> Needs:
    rve = case.rve
    voxels = int(np.prod(rve.grid))
    count = rve.recipe.realisations if rve.recipe else 1
    cubes = count + sum((count if rve.recipe else 8) * share**3 for share in rve.parts)
    planes = (count if rve.recipe else 8) * (1 + len(rve.parts)) * rve.sections
    planes *= len(section_normals((1.0, 1.0, 1.0), rve.level))
    return Needs(
        kinematics="small strain, both sides of a crack move freely",
        choices=(
            Choice("sections", f"{rve.sections} for each normal, exact areas, eq (1)"),
            Choice(
                "bounds",
                "traction and displacement sides, to test whether the volume is representative",
            ),
        ),
        libraries=("numba",),
        memory=int(BYTES * voxels),
        seconds=cubes * SECONDS * voxels + planes * SECTION_SECONDS,
    )


REPRESENTATIVE_VOLUME = Stage(
    schema=RVE,
    tables=("rve",),
    reads={"title", "rve"},
    run=lambda case, datasets, job: measure_case(case.rve, job).assign_attrs(title=case.title),
    needs=_needs,
    prepare=lambda case: case.rve.first(),
    knobs=volume_knobs,
    question="How stiff is the solid with its pores and cracks, and which sections are damaged?",
    answer=_answer,
    sections=_sections,
    folders=(FOLDER,),
    answers=(*(f"modulus_{axis}" for axis in "xyz"), "largest_damage", "porosity"),
    compared=_compared,
)


GROWTH_SECONDS = 1e-6  # CPU seconds of a crack in an event; about 150 events cut a volume


def _grow(case: Case, datasets: Datasets, job: Job) -> Dataset:
    volumes = case.growth.volumes(case.rve)
    share, cracks = np.array([share for share, _ in volumes]), [cracks for _, cracks in volumes]
    axis = "xyz".index(case.growth.pull)
    result = grow_volumes(cracks, share, axis=axis, through=case.growth.through)
    return result.assign_attrs(title=case.title)


def _growth_answer(growth: Dataset) -> Iterator[str]:
    whole = (growth["share"] == 1.0) & (growth["converged"] == 1)
    damage = float(growth["peak_damage"].to_numpy()[whole.to_numpy()].mean())
    yield from View(growth).sentences(
        growth,
        "A volume of {size} has a tensile strength of {strength:()} along {way}, at a damage of "
        "{worst} in its worst section, eq (1); its fracture energy is {fracture_energy:()}.",
        size=readable(f"{float(growth.attrs['edge']):.4g} m"),
        way="xyz"[int(growth.attrs["axis"])],
        worst=f"{damage:.3g}",
    )


def _tabulate_growth(growth: Dataset) -> Rows:
    share, cut = (growth[name].to_numpy() for name in ("share", "converged"))
    means = {
        "strength (MPa)": 1e-6 * growth["volume_strength"].to_numpy(),
        "energy (J/m2)": growth["volume_energy"].to_numpy(),
        "damage at the strength": growth["peak_damage"].to_numpy(),
    }
    counted = {"cut": lambda size: f"{int(cut[share == size].sum())}"}
    return _by_size(growth, float(growth.attrs["edge"]), means, counted)


def _growth_sections(datasets: Datasets, out: Path) -> Iterator[Section]:
    growth = datasets[VOLUME_GROWTH.name]
    figures = {
        "crack_damage": on_axes(rve_figures.plot_crack_damage, growth),
        "softening": on_axes(rve_figures.plot_softening, growth),
    }
    caption = ["Means over volumes, ± the standard deviation."]
    yield Section("Growth of cracks", caption, *_tabulate_growth(growth), figures=figures)


def _growth_needs(case: Case) -> Needs:
    assert case.rve.size is not None
    count = len(case.rve.cracks)
    volumes = 1
    if case.rve.recipe is not None:
        count = round(sum(case.rve.recipe.counts(case.rve.size).values()))
        volumes = case.rve.recipe.realisations
    how = "event by event, without iteration; a crack that reaches another crack " + (
        "grows on independently" if case.growth.through else "ends its volume"
    )
    return Needs(
        seconds=150 * volumes * count * GROWTH_SECONDS, choices=(Choice("growth of cracks", how),)
    )


GROWING_CRACKS = Stage(
    schema=VOLUME_GROWTH,
    tables=("rve", "growth"),
    reads={"title", "rve", "growth"},
    takes=(REPRESENTATIVE_VOLUME,),
    run=_grow,
    needs=_growth_needs,
    prepare=lambda case: case.growth.volumes(case.rve),
    question="Which tension does the solid with its cracks carry, and how does it soften?",
    answer=_growth_answer,
    sections=_growth_sections,
    answers=("strength", "fracture_energy"),
)

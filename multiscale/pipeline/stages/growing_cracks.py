"""Stage: cracks of the representative volume that grow until they cut it."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from multiscale.micro.damage import grow_volumes
from multiscale.needs import Choice, Needs
from multiscale.pipeline.settings import Case
from multiscale.pipeline.showing import Rows, View, say_mean
from multiscale.pipeline.stage import Datasets, Job, Section, Stage
from multiscale.pipeline.stages.representative_volume import REPRESENTATIVE_VOLUME
from multiscale.plotting.figure import on_axes
from multiscale.plotting.rve_figures import plot_crack_damage, plot_softening
from multiscale.schema import VOLUME_GROWTH, Dataset
from multiscale.units import readable

__all__ = ["GROWING_CRACKS"]

EVENT_SECONDS = 1e-6
"""CPU seconds of a crack in an event; there are about 150 events of a crack that cuts a volume."""


def _run(case: Case, found: Datasets, job: Job) -> Dataset:
    volumes = case.growth.volumes(case.rve)
    share = np.array([one for one, _ in volumes])
    cracks = [one for _, one in volumes]
    axis = "xyz".index(case.growth.pull)
    result = grow_volumes(cracks, share, axis=axis, through=case.growth.through)
    return result.assign_attrs(title=case.title)


def _answer(growth: Dataset) -> Iterator[str]:
    whole = (growth["share"] == 1.0) & (growth["converged"] == 1)
    damage = float(growth["peak_damage"].to_numpy()[whole.to_numpy()].mean())
    yield from View(growth).sentences(
        growth,
        "A volume of {size} bears a tension of {strength:()} along {way}, at a damage of {worst} "
        "of its worst section, eq (1); its crack then takes {fracture_energy:()}.",
        size=readable(f"{float(growth.attrs['edge']):.4g} m"),
        way="xyz"[int(growth.attrs["axis"])],
        worst=f"{damage:.3g}",
    )


def _tabulate(growth: Dataset) -> Rows:
    """Head and rows of the size effect: means and standard deviations over volumes."""
    head = ("edge", "volumes", "cut", "strength (MPa)", "energy (J/m2)", "damage at the strength")
    share, rows = growth["share"].to_numpy(), []
    columns = (("volume_strength", 1e-6), ("volume_energy", 1.0), ("peak_damage", 1.0))
    for one in np.unique(share):
        own = share == one
        rows.append(
            (
                readable(f"{one * float(growth.attrs['edge']):.4g} m"),
                f"{own.sum()}",
                f"{int(growth['converged'].to_numpy()[own].sum())}",
                *(say_mean(scale * growth[name].to_numpy()[own]) for name, scale in columns),
            )
        )
    return head, rows


def _sections(found: Datasets, out: Path) -> Iterator[Section]:
    growth = found[VOLUME_GROWTH.name]
    figures = {
        "crack_damage": on_axes(plot_crack_damage, growth),
        "softening": on_axes(plot_softening, growth),
    }
    told = ["Means over volumes, ± one standard deviation."]
    yield Section("Growth of cracks", told, *_tabulate(growth), figures=figures)


def _needs(case: Case) -> Needs:
    assert case.rve.size is not None
    count = len(case.rve.cracks)
    volumes = 1
    if case.rve.recipe is not None:
        count = round(sum(case.rve.recipe.counts(case.rve.size).values()))
        volumes = case.rve.recipe.realisations
    told = "event by event, no iteration; a crack that reaches another one " + (
        "grows on as if it were alone" if case.growth.through else "ends its volume"
    )
    return Needs(
        seconds=150 * volumes * count * EVENT_SECONDS, choices=(Choice("growth of cracks", told),)
    )


GROWING_CRACKS = Stage(
    schema=VOLUME_GROWTH,
    tables=("rve", "growth"),
    reads={"title", "rve", "growth"},
    takes=(REPRESENTATIVE_VOLUME,),
    run=_run,
    needs=_needs,
    prepare=lambda case: case.growth.volumes(case.rve),
    question="Which tension does the solid with its cracks bear, and how does it soften?",
    answer=_answer,
    sections=_sections,
    pictures=("crack_damage", "softening"),
    answers={"strength": "", "fracture_energy": ""},
)

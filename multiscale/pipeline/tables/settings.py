"""The case, with all tables and the checks of tables against each other."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self, get_args

from pydantic import Field, ValidationInfo, field_validator, model_validator

from multiscale.errors import CaseError
from multiscale.micro.layer import depth_caution
from multiscale.pipeline.tables import case_tables, grain_settings, link_settings, tyre_settings
from multiscale.pipeline.tables.assembly_settings import Bodies, LoadCycles, LoadSteps
from multiscale.pipeline.tables.case_tables import ABSENT, MeasuredTable
from multiscale.pipeline.tables.cell_faults import cell_faults
from multiscale.pipeline.tables.cycled_settings import (
    FatigueSettings,
    GrowthSettings,
    VibrationSettings,
)
from multiscale.pipeline.tables.joint_settings import (
    Cycles,
    JointLaw,
    JointPreloads,
    LawSource,
    LoadFactors,
    OpenLaw,
    RisingPreloads,
    RoughInterface,
    Substructures,
)
from multiscale.pipeline.tables.made_bodies import Blocks, LapJoint, Plate, StackedBlocks
from multiscale.pipeline.tables.rough_bodies import (
    CONDUCTIVITIES,
    InstrumentSurface,
    RoughBody,
    SyntheticSurface,
)
from multiscale.pipeline.tables.rve_settings import RveSettings
from multiscale.pipeline.tables.toml_model import OneOf, Settings, list_tables
from multiscale.schema import INTERFACE_LAW, Dataset
from multiscale.units import readable
from multiscale.upscaling import at_speed
from multiscale.upscaling.sampling import FEWEST_PAIRS

if TYPE_CHECKING:
    from multiscale.pipeline.stage import Datasets

FEWEST_LAYERS = 4  # of cells on half of their points

Structure = (
    Blocks
    | link_settings.TensegrityGrid
    | link_settings.CableNet
    | link_settings.LinkTable
    | link_settings.LinkMesh
    | link_settings.EquivalentPlate
    | Plate
    | StackedBlocks
    | LapJoint
    | Bodies
    | grain_settings.Deposit
    | grain_settings.Silo
    | grain_settings.ColumnCollapse
    | grain_settings.ShearCell
    | grain_settings.Biaxial
)
"""All kinds of structures."""

KINDS = {get_args(kind.model_fields["kind"].annotation)[0]: kind for kind in get_args(Structure)}
"""Every kind by its name in files."""

OTHER_MICRO_KEYS = {"realisations", "coarser", "shear", "control", "control_realisations"}
"""Keys of [micro] that do not change pressed cells."""

CELLS = ("body_1", "body_2", "cell", "micro")
"""Tables of cells; a case has all of them, or not the last two."""

OF_CELLS = ("cell", "micro", "law", "measured", "slide", "seal")  # of cases with cells
OF_RUBBER = ("rubber", "road", "sliding", "tread")  # tables of cases of rubber on a road

WITH_STRUCTURE = ("interface", "statics", "cycles", "dynamics", "vibration", "grains", "motion")
"""Tables of kinds of structures."""


class Case(Settings):
    """A question about two surfaces and a structure, or about one of both.

    The tables determine the stages. Cells need both bodies, cell and micro, and give the law of
    the interfaces of the structure. Without cells the law comes from a file, or the structure has
    no interfaces. Further tables of a structure depend on its kind. A case of rubber has a road
    and a tread block instead; its cells and law have fewer keys.
    """

    title: str = Field(description="Title of report and tables.")
    elastic: bool = False
    """Confirms an elastic answer at real contact pressures above the strength of metals."""
    strict: bool = False
    """Refuses joints with an assumed friction or stiffness ratio."""
    body_1: RoughBody = ABSENT
    body_2: RoughBody = ABSENT
    cell: case_tables.CellSettings = ABSENT
    micro: case_tables.MicroSettings = ABSENT
    law: case_tables.LawSettings = ABSENT
    measured: tuple[MeasuredTable, ...] = Field(ABSENT, min_length=1)
    """Measured joints, by which the law of the cells is calibrated."""
    slide: case_tables.SlideSettings = Field(
        ABSENT, description="Slide of the bodies over each other."
    )
    seal: case_tables.SealSettings = ABSENT
    accuracy: case_tables.AccuracySettings = ABSENT
    """Target for the error of an answer; a planner chooses the settings."""
    rve: RveSettings = ABSENT
    growth: GrowthSettings = ABSENT
    structure: Structure | None = Field(None, discriminator="kind")
    interface: Annotated[Any, OneOf((LawSource, RoughInterface, JointLaw))] = None
    statics: Annotated[
        Any, OneOf((RisingPreloads, JointPreloads, LoadFactors, LoadSteps, link_settings.Statics))
    ] = None
    cycles: Annotated[Any, OneOf((Cycles, LoadCycles))] = None
    dynamics: link_settings.Dynamics | None = None
    vibration: VibrationSettings = ABSENT
    substructures: Substructures | None = None
    fatigue: FatigueSettings = ABSENT
    grains: grain_settings.GrainSettings = ABSENT
    motion: grain_settings.Motion = ABSENT
    third_body: grain_settings.ThirdBody = ABSENT
    rubber: tyre_settings.Rubber = ABSENT
    road: SyntheticSurface = Field(ABSENT, description="Surface of the road.")
    sliding: tyre_settings.Slides = ABSENT
    tread: tyre_settings.Tread = ABSENT

    @model_validator(mode="before")
    @classmethod
    def _fit_law_of_cells(cls, given: Any) -> Any:
        """Add the table of a law to cells, and leakage to a case with a seal."""
        if "seal" in given and isinstance(given.get("micro"), dict):
            given = given | {"micro": {"leakage": True} | given["micro"]}
        return {"law": {}} | given if {"micro", "rubber", "third_body"} & given.keys() else given

    @field_validator("interface", "statics", "cycles", mode="before")
    @classmethod
    def _read_as_kind(cls, given: Any, info: ValidationInfo) -> Any:
        """Read a table by the model of the kind of structure."""
        structure = info.data.get("structure")
        model = structure.models.get(str(info.field_name)) if structure else None
        return given if model is None else model.model_validate(given)

    def _faults(self) -> Iterator[str]:
        if self.measured is None and self.law is not None and (given := self.law.of_calibration):
            yield (
                f"{' and '.join(given)} in [law] need measured joints for the calibration; "
                f"give their tables by [[measured]], or leave them out"
            )
        if self.law is not None and self.micro is not None and self.micro.shear is not None:
            for name in {"friction", "stiffness_ratio"}.intersection(self.law.of_calibration):
                yield (
                    f"{name} in [law] is for cells without shear, and [micro.shear] measures "
                    f"it; leave out one of them"
                )
        if any(self._has(name) for name in OF_RUBBER):
            yield from tyre_settings.rubber_faults(self)
            return
        if self.growth is not None and self.rve is None:
            yield "[growth] takes the cracks of [rve], and the case has no [rve]; give it"
        asked = [name for name in OF_CELLS if self._has(name)]
        missing = [name for name in CELLS if not self._has(name)]
        if self.third_body is not None:
            yield from grain_settings.third_body_faults(self)
            asked, missing = [], []
        if missing and (asked or (self.structure is None and self.rve is None)):
            yield (
                f"without {list_tables(missing)} there are no cells, which take "
                f"{list_tables(CELLS)}"
            )
        if self.has_cells:
            yield from cell_faults(self)
        if self.structure is not None:
            yield from self._structure_faults(self.structure)
        if self.growth is not None and self.structure and not self.structure.may_tire:
            yield (
                '[growth] cracks a body of [structure] kind = "bodies"; leave out one of them, or '
                "give such a structure"
            )
        if self.fatigue is not None and not (self.structure and self.structure.may_tire):
            yield (
                '[fatigue] needs the elements of [structure] kind = "bodies", "lap_joint" or '
                '"stacked_blocks"; leave it out, or give such a structure'
            )

    def _has(self, name: str) -> bool:
        return getattr(self, name) is not None

    def _structure_faults(self, kind: Structure) -> Iterator[str]:
        given = {name for name in WITH_STRUCTURE if self._has(name)}
        if self.third_body is not None:
            given.discard("grains")
        if given not in [set(tables) for tables in kind.asks]:
            asked = " or ".join(list_tables(tables) for tables in kind.asks)
            yield (
                f"a structure of kind {kind.kind!r} takes {asked}, got {list_tables(sorted(given))}"
            )
        if self.substructures is not None and not kind.may_be_cut:
            yield (
                f"[substructures] cut grids, nets, tables and meshes of links, plates and bodies "
                f"with joints, not a structure of kind {kind.kind!r}"
            )
        if self.cut.model != "resolved" and kind.stage != "links":
            yield (
                f"homogenised substructures consist of links, unlike a structure of kind "
                f"{kind.kind!r}; leave out model in [substructures]"
            )
        if kind.of_bodies and not (self._has("body_1") and self._has("body_2")):
            yield (
                f"a structure of kind {kind.kind!r} is made of [body_1] and [body_2]; give the "
                f"youngs_modulus and the poissons_ratio of both"
            )
        if self.makes_law and self.interface is not None and self.interface.law is not None:
            yield (
                "[interface] law names a file, and the structure takes the law of the cells; leave "
                "out law, or the cells"
            )
        if self.makes_law and self.interface is not None and self.interface.law_error is not None:
            yield (
                "[interface] law_error belongs to a table, and the law of the cells has an error "
                "budget; leave out law_error"
            )
        yield from kind.faults_with(self)

    @property
    def conductivities(self) -> dict[str, tuple[float, float]]:
        """Given conductivities of both bodies by the name of the conductance."""
        pairs = {
            name.replace("conductivity", "conductance"): tuple(
                getattr(body, name) for body in self.bodies
            )
            for name in CONDUCTIVITIES
        }
        return {name: pair for name, pair in pairs.items() if None not in pair}

    def without_coatings(self) -> Self:
        """Return the case of the bodies without their coatings."""
        bare = [body.model_copy(update={"coating": ()}) for body in self.bodies]
        return self.model_copy(update={"body_1": bare[0], "body_2": bare[1]})

    @property
    def coated(self) -> bool:
        """Whether a body has coatings."""
        return any(body.coating for body in self.bodies)

    @property
    def tables(self) -> frozenset[str]:
        """Tables that are given, and the stages of structure, cut and cells."""
        solved = self.structure is not None and self.vibration is None
        asked = {self.structure.stage} if self.structure is not None and solved else set()
        condensed = {"homogenise"} if self.cut.homogenise and solved else set()
        sheared = {"micro.shear"} if self.has_cells and self.micro.shear is not None else set()
        again = {"micro.coarser"} if self.has_cells and self.micro.coarser else set()
        control = {"micro.control"} if self.controlled else set()
        wider = {"third_body.wider"} if self.third_body and self.third_body.wider else set()
        tables = super().tables | asked | condensed | sheared | again | control | wider
        return tables if self.third_body is None else tables - {"grains"}

    @property
    def controlled(self) -> bool:
        """Whether flat cells are control variates of the cells."""
        if self.has_cells and (self.micro.control or self.micro.control_realisations):
            return True
        return self.beside_flat and self.micro.realisations >= FEWEST_PAIRS

    @property
    def beside_flat(self) -> bool:
        """Whether the cells are not flat and may have flat control cells."""
        dear = self.has_cells and self.cell.geometry != "flat" and self.cell.mesh is None
        return dear and self.micro.control is not False and not self.from_maps

    @property
    def from_maps(self) -> bool:
        """Whether a surface is a measured map, with a limited number of cells."""
        return any(isinstance(body.surface, InstrumentSurface) for body in self.bodies)

    @property
    def has_cells(self) -> bool:
        """Whether the case has cells."""
        return self.micro is not None

    @property
    def makes_law(self) -> bool:
        """Whether the case makes a law, from cells of two bodies or of grains."""
        return self.has_cells or self.third_body is not None

    @property
    def bodies(self) -> tuple[RoughBody, RoughBody]:
        """Both bodies."""
        return self.body_1, self.body_2

    @property
    def hardness(self) -> float | None:
        """Hardness of the softer body, Pa; None if no body has a hardness."""
        return None if self.softer is None else self.softer.surface_hardness

    @property
    def softer(self) -> RoughBody | None:
        """The body with the smallest hardness at its surface; None if no body has a hardness."""
        given = [body for body in self.bodies if body.surface_hardness is not None]
        return min(given, key=lambda body: body.surface_hardness or 0.0, default=None)

    @property
    def yield_stress(self) -> float | None:
        """Yield stress of a conforming cell, Pa, from the softer body."""
        if self.softer is None or self.cell.geometry == "flat":
            return None
        return self.softer.yield_stress

    @property
    def interface_width(self) -> float | None:
        """Edge of an interface under uniform pressure, m; None in other structures."""
        return None if self.structure is None else self.structure.interface_width

    @property
    def extrapolate(self) -> bool:
        """Whether answers far outside the data of the law are given."""
        tables = (self.law, self.interface)
        return any(table.extrapolate for table in tables if table is not None)

    @property
    def way(self) -> str:
        """Way of the cells for the interfaces of the structure."""
        return "sequential" if self.interface is None else self.interface.way

    @property
    def adaptive(self) -> bool:
        """Whether cells are pressed at further pressures of the structure."""
        return self.way in ("adaptive", "concurrent")

    @property
    def cut(self) -> Substructures:
        """The cut of the structure; a single substructure if not given."""
        return self.substructures or Substructures()

    @property
    def known_shear(self) -> set[str]:
        """Parameters of the sliders that the law of the cells has, from cells or the case."""
        if self.micro.shear is not None:
            return {"friction", "stiffness_ratio"}
        slid = self.slide is not None and self.slide.distance >= self.cell.size[0]
        stated = set() if self.law is None else set(self.law.of_calibration) - {"roughness"}
        return stated | ({"friction"} if slid else set())

    def interface_law(self, datasets: "Datasets", open_law: OpenLaw) -> Dataset:
        """Law of the interfaces of the structure, from the cells or from another case."""
        source = self.interface or LawSource()
        if self.makes_law:
            return at_speed(datasets[INTERFACE_LAW.name], source.speed)
        law: Dataset = source.read(open_law)
        return law

    def from_structure(self, law: Path | None) -> Self:
        """Return the part of the case that begins at the structure, with the law of a file."""
        if self.structure is None:
            raise CaseError(f"{self.title}: the case has no [structure]; use multiscale run")
        if self.rve is not None:
            raise CaseError(
                f"{self.title}: the structure takes the [rve] of the case, which is computed "
                f"before it; use multiscale run"
            )
        source = self.structure.models.get("interface")
        if law is not None and source is None:
            raise CaseError(f"{self.title}: the structure has no joint for the law {law}")
        of_bodies = () if self.structure.of_bodies else CELLS[:2]
        of_grains = () if self.third_body is None else ("third_body", "grains")
        changes = dict.fromkeys((*OF_CELLS, "accuracy", *of_bodies, *of_grains))
        if source is not None:
            update = {"extrapolate": self.extrapolate} | (
                {} if law is None else {"law": law, "way": "sequential"}
            )
            changes["interface"] = (self.interface or source()).model_copy(update=update)
        return self.model_copy(update=changes)

    def pressed_at(self, pressures: Iterable[float]) -> Self:
        """Return the case of cells under other pressures."""
        changes = {"pressures": tuple(sorted(pressures)), "spots": False}
        micro = self.micro.model_copy(update=changes)
        return self.model_copy(update={"micro": micro})

    def coarser(self) -> Self:
        """Return the case of the first cells on half of their points."""

        def halved(points: tuple[int, int], layers: int) -> dict[str, Any]:
            return {
                "points": tuple(n // 2 for n in points),
                "layers": max(FEWEST_LAYERS, layers // 2),
            }

        cell, micro, shear = self.cell, self.micro, self.micro.shear
        if shear is not None:
            grid = halved(shear.points or cell.points, shear.layers or cell.layers)
            fewer = {"realisations": min(micro.coarser, shear.realisations)}
            shear = shear.model_copy(update=grid | fewer)
        micro = micro.model_copy(update={"realisations": micro.coarser, "shear": shear})
        cell = cell.model_copy(update=halved(cell.points, cell.layers))
        return self.model_copy(update={"cell": cell, "micro": micro})

    def control(self, count: int) -> Self:
        """Return the case of flat cells on the same and on further surfaces."""
        plain = dict.fromkeys(("element", "sides"))
        cell = self.cell.model_copy(update={"geometry": "flat", **plain})
        micro = self.micro.model_copy(update={"realisations": count})
        return self.model_copy(update={"cell": cell, "micro": micro})

    def only_rve(self) -> Self:
        """Return the part of the case that is its representative volume."""
        if self.rve is None:
            raise CaseError(f"{self.title}: the case has no [rve], so no representative volume")
        return self._only("rve", "growth")

    def without_structure(self) -> Self:
        """Return the part of the case that ends at the law."""
        of_grains = () if self.third_body is None else ("third_body", "grains")
        return self._only(*CELLS, "law", "measured", "slide", *of_grains)

    def _only(self, *tables: str) -> Self:
        """Return the case with some of its tables, and all keys outside of tables."""
        others = set(type(self).model_fields) - {"title", "elastic", "strict", *tables}
        return self.model_copy(update=dict.fromkeys(others))

    def quick(self) -> Self:
        """Return the same case with coarser and fewer cells, elements, grains and steps."""
        remark = self.structure.quick_title() if self.structure else "quick"
        changes: dict[str, Any] = {"title": f"{self.title} ({remark})", "accuracy": None}
        small = self.smaller()
        if self.rubber is not None:
            samples = min(tyre_settings.QUICK_SAMPLES, self.law.samples)
            changes["law"] = self.law.model_copy(update={"samples": samples})
        if self.third_body is not None:  # fewer grains would make a lower layer
            changes["grains"] = self.grains
        if self.slide is not None:
            changes["slide"] = small.slide.within(self.cell, self.micro)
        if self.has_cells and (shear := small.micro.shear) is not None and shear.points:
            grid = zip(shear.points, small.cell.points, strict=True)
            shear = shear.model_copy(update={"points": tuple(map(min, grid))})
            changes["micro"] = small.micro.model_copy(update={"shear": shear})
        if small.structure is not None:
            changes["structure"] = small.structure.within(small)
        return small.model_copy(update=changes)

    def cautions(self) -> Iterator[str]:
        """Yield cautions about the cells, a sentence each."""
        if self.rubber is not None:
            yield from tyre_settings.doubt_road(self)
            return
        for number, body in enumerate(self.bodies, start=1):
            if body.surface is not None:
                shortest = body.surface.short_cutoff
                yield from self.cell.caution_wavelength(
                    shortest, f"body_{number}", "gap and contact area need"
                )
            if body.hardness is not None and (self.hardness or 0.0) > body.hardness:
                thick = readable(f"{sum(layer.thickness for layer in body.coating):.3g} m")
                yield (
                    f"local pressures reach {readable(f'{self.hardness:.3g} Pa')}, above the "
                    f"hardness of body_{number} below its coating: spots wider than the thickness "
                    f"of the coating, {thick}, press this softer body, which is not computed"
                )
        if self.cell.depth is not None:
            yield from filter(None, [depth_caution(self.cell.depth, max(self.cell.size))])
        yield from case_tables.doubt_scatter(self.micro.realisations)

    @property
    def scope(self) -> str:
        """Short description of the cases of the same run folder."""
        if self.cell is not None:
            return self.cell.scope
        if self.third_body is not None:
            return "cells of grains"
        if self.structure is None:
            return "a representative volume"
        return f"a structure of kind {self.structure.kind!r}"

    def identity(self) -> str:
        """Checksum of the case of a run folder: its cells, or its structure without cells.

        It includes the content of instrument files, but not the number of realisations and the
        sheared cells.
        """
        if self.rubber is not None:
            return self.checksum(
                include={*OF_RUBBER[:3], "cell"}, exclude={"sliding": {"realisations"}}
            )
        if self.third_body is not None:
            return self.checksum(
                include={"grains", "third_body"}, exclude={"third_body": {"realisations", "wider"}}
            )
        tables = {"structure", "grains"} if self.structure else {"rve"}
        tables = set(CELLS) if self.has_cells else tables
        excluded: dict[str, Any] = {"micro": OTHER_MICRO_KEYS}
        excluded |= {body: set(CONDUCTIVITIES) for body in ("body_1", "body_2")}
        return self.checksum(include=tables, exclude=excluded)

"""What a case may say: every key with its unit, range and default."""

import hashlib
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from multiscale.io import read_bytes
from multiscale.micro.cell import depth_caution
from multiscale.pipeline.toml_model import Count, Length, Number, Pressure, Settings, must_rise

__all__ = [
    "POINTS_PER_WAVE",
    "AccuracySettings",
    "Body",
    "Case",
    "CellSettings",
    "InstrumentSurface",
    "JointSettings",
    "LawSettings",
    "MicroSettings",
    "SyntheticSurface",
]

FEWEST_REALISATIONS = 3  # for a band
POINTS_PER_WAVE = 8  # of the shortest wave of a measured surface, if the case names no cut-off

Points = Annotated[Count, Field(ge=4, le=8192, multiple_of=2)]


class SyntheticSurface(Settings):
    """A self-affine surface; see :func:`multiscale.micro.self_affine`.

    Parameters
    ----------
    rms_height, rms_slope : quantity
        Exactly one of them; m and 1.
    hurst_exponent : float
        Between 0 and 1.
    long_cutoff, short_cutoff : quantity
        Longest and shortest wavelength, m.
    roll_off : quantity, optional
        Wavelength above which the spectrum is flat, m.
    """

    rms_height: Length | None = None
    rms_slope: Annotated[Number, Field(gt=0.0)] | None = None
    hurst_exponent: Annotated[Number, Field(ge=0.0, le=1.0)]
    long_cutoff: Length
    short_cutoff: Length
    roll_off: Length | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.rms_height is None) == (self.rms_slope is None):
            raise ValueError("give either rms_height or rms_slope")
        if self.short_cutoff > self.long_cutoff:
            raise ValueError(
                f"short_cutoff ({self.short_cutoff:g} m) must not be longer than long_cutoff "
                f"({self.long_cutoff:g} m)"
            )
        return self


class InstrumentSurface(Settings):
    """A measured map, cut into one window per realisation.

    Parameters
    ----------
    file : path
        Instrument file; relative to the case file.
    detrend_order : int
        0 mean, 1 plane, 2 curvature; of the whole map, and the plane of each window.
    fill_undefined : bool
        Whether undefined points are filled; refused otherwise.
    periodic : {"mirror", "window"}
        How a window is made periodic: reflected (it covers a quarter of the cell) or faded along
        its edges.
    short_cutoff : quantity, optional
        Shortest wavelength kept, m; eight points of the cell's grid if not given.
    """

    file: Path
    detrend_order: Annotated[Count, Field(ge=0, le=2)] = 2
    fill_undefined: bool = False
    periodic: Literal["mirror", "window"] = "mirror"
    short_cutoff: Length | None = None


def _kind_of_surface(value: Any) -> str:
    named = value if isinstance(value, dict) else getattr(value, "__dict__", {})
    return "instrument" if "file" in named else "synthetic"


class Body(Settings):
    """One of the two bodies.

    Parameters
    ----------
    youngs_modulus : quantity
        Pa.
    poissons_ratio : float
        From 0 to 0.4999.
    surface : table, optional
        Synthetic or measured roughness; smooth if not given.
    hardness : quantity, optional
        Largest local pressure, Pa; the softer body's counts. Flat cells only.
    """

    youngs_modulus: Pressure
    poissons_ratio: Annotated[Number, Field(ge=0.0, le=0.4999)]
    surface: (
        Annotated[
            Annotated[SyntheticSurface, Tag("synthetic")]
            | Annotated[InstrumentSurface, Tag("instrument")],
            Discriminator(_kind_of_surface),
        ]
        | None
    ) = None
    hardness: Pressure | None = None


class CellSettings(Settings):
    """The representative surface element.

    Parameters
    ----------
    size : two quantities
        Edge lengths, m.
    points : two ints
        Grid points along x and y; even.
    depth : quantity, optional
        Depth of the elastic layer, m; the longer edge if not given.
    layers : int
        Layers of elements.
    geometry : {"conforming", "flat"}
        Whether the mesh follows the surface, or the surface is the gap of a flat layer: fast, for
        small slopes.
    """

    size: tuple[Length, Length]
    points: tuple[Points, Points]
    depth: Length | None = None
    layers: Annotated[Count, Field(ge=2, le=1000)] = 12
    geometry: Literal["conforming", "flat"] = "conforming"


class MicroSettings(Settings):
    """The ensemble of cells.

    Parameters
    ----------
    realisations : int
        Number of cells.
    pressures : list of quantities
        Mean pressures, Pa, rising.
    seed : int
        Of the first realisation.
    """

    realisations: Annotated[Count, Field(ge=1)]
    pressures: Annotated[tuple[Pressure, ...], Field(min_length=3)]
    seed: Annotated[Count, Field(ge=0)] = 0

    _rise = field_validator("pressures")(must_rise)


class LawSettings(Settings):
    """The fit of the interface law.

    Parameters
    ----------
    terms : int
        Terms of the normal law.
    samples : int
        Bootstrap samples.
    """

    terms: Annotated[Count, Field(ge=6)] = 20
    samples: Annotated[Count, Field(ge=0)] = 200


class JointSettings(Settings):
    """Two blocks pressed together through the law.

    Parameters
    ----------
    height : quantity
        Height of each block, m.
    width : quantity
        Edge of their square section, m.
    preloads : list of quantities
        Nominal pressures, Pa, rising.
    """

    height: Length
    width: Length
    preloads: Annotated[tuple[Pressure, ...], Field(min_length=1)]

    _rise = field_validator("preloads")(must_rise)


class AccuracySettings(Settings):
    """How sure the answer has to be; the rest of the case is then where a planner starts from.

    Parameters
    ----------
    target : quantity
        Largest total of the error budget, relative, such as ``"2 %"``.
    quantity : {"joint_stiffness", "mean_gap", "contact_fraction", "stiffness"}
        What the target is for, at every preload or, for the last three, at every pressure of the
        cells.
    """

    target: Annotated[Number, Field(gt=0.0, le=0.5)]
    quantity: Literal["joint_stiffness", "mean_gap", "contact_fraction", "stiffness"] = (
        "joint_stiffness"
    )


class Case(Settings):
    """One question, such as how stiff the joint of two bodies is.

    Parameters
    ----------
    title : str
    body_1, body_2 : Body
    cell : CellSettings
    micro : MicroSettings
    law : LawSettings
    joint : JointSettings
    accuracy : AccuracySettings
        If given, a planner chooses cells, grid and realisations.
    """

    title: str
    body_1: Body
    body_2: Body
    cell: CellSettings
    micro: MicroSettings
    law: LawSettings = LawSettings()
    joint: JointSettings
    accuracy: AccuracySettings | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.body_1.surface is None and self.body_2.surface is None:
            raise ValueError("both bodies are smooth; give one of them a [surface] table")
        if self.hardness is not None and self.cell.geometry != "flat":
            raise ValueError(
                'hardness limits the pressure of flat cells only; set geometry = "flat" in [cell]'
            )
        return self

    @property
    def bodies(self) -> tuple[Body, Body]:
        """Both bodies."""
        return self.body_1, self.body_2

    @property
    def hardness(self) -> float | None:
        """Hardness of the softer body, Pa, if one is given."""
        given = [body.hardness for body in self.bodies if body.hardness is not None]
        return min(given, default=None)

    def quick(self) -> Self:
        """Return the same case on a coarser grid with fewer realisations, and without a target."""
        points = tuple(max(4, 2 * ((n + 2) // 4)) for n in self.cell.points)
        micro = self.micro.model_copy(update={"realisations": min(4, self.micro.realisations)})
        return self.model_copy(
            update={
                "title": f"{self.title} (quick)",
                "cell": self.cell.model_copy(update={"points": points}),
                "micro": micro,
                "law": self.law.model_copy(update={"samples": min(40, self.law.samples)}),
                "accuracy": None,
            }
        )

    def cautions(self) -> list[str]:
        """Return what a user should know before trusting the results, one sentence each."""
        found = []
        spacing = max(
            length / n for length, n in zip(self.cell.size, self.cell.points, strict=True)
        )
        for number, body in enumerate(self.bodies, start=1):
            cutoff = body.surface.short_cutoff if body.surface else None
            if cutoff is not None and cutoff < 0.99 * POINTS_PER_WAVE * spacing:
                found.append(
                    f"the shortest wave of body_{number} has {cutoff / spacing:.1f} points; "
                    f"gap and contact area need {POINTS_PER_WAVE} or more"
                )
        if self.cell.depth is not None and (
            shallow := depth_caution(self.cell.depth, max(self.cell.size))
        ):
            found.append(shallow)
        low, high = self.micro.pressures[0], self.micro.pressures[-1]
        outside = [p for p in self.joint.preloads if not low <= p <= high]
        if outside:
            values = ", ".join(f"{1e-6 * p:g}" for p in outside)
            found.append(
                f"the law extrapolates at the preloads {values} MPa: the cells were pressed at "
                f"{1e-6 * low:g} to {1e-6 * high:g} MPa"
            )
        if self.micro.realisations < FEWEST_REALISATIONS:
            found.append(
                f"{self.micro.realisations} realisation(s) say too little about the scatter: there "
                f"are no bands below {FEWEST_REALISATIONS}"
            )
        for number, body in enumerate(self.bodies, start=1):
            if isinstance(body.surface, InstrumentSurface) and body.surface.periodic == "window":
                found.append(
                    f"the windows of body_{number} fade along their edges, which lowers their rms "
                    f"height by about an eighth"
                )
        return found

    def identity(self) -> str:
        """Checksum of everything that a realisation depends on, instrument files included."""
        content = self.model_dump_json(
            exclude={
                "title": True,
                "law": True,
                "joint": True,
                "accuracy": True,
                "micro": {"realisations"},
                "body_1": {"surface": {"file"}},
                "body_2": {"surface": {"file"}},
            }
        )
        checksum = hashlib.sha256(content.encode())
        for body in self.bodies:
            if isinstance(body.surface, InstrumentSurface):
                checksum.update(read_bytes(body.surface.file))
        return checksum.hexdigest()

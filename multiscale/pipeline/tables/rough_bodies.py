"""Tables of the two bodies of a case: their surfaces and materials."""

from collections.abc import Iterator
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag, field_validator

from multiscale.pipeline.tables import toml_model as toml
from multiscale.surfaces import Anisotropy

if TYPE_CHECKING:
    from multiscale.micro import Coating

TABOR, INDENTED = 2.8, 0.08
"""Hardness over flow stress, and the plastic strain of this stress under a Vickers indenter (D.
Tabor, The Hardness of Metals, Oxford 1951)."""


Slope = Annotated[toml.Number, Field(gt=0.0)]
Angle = Annotated[float, toml.quantity("rad"), toml.with_unit("rad")]
UnitOfLength = Annotated[
    toml.Length, BeforeValidator(lambda value: f"1 {value}" if str(value)[:1].isalpha() else value)
]

CONDUCTIVITIES = ("thermal_conductivity", "electrical_conductivity")  # keys of a body


class AnisotropySettings(toml.Settings):
    """Lay of a synthetic surface, along which its wavelengths are longer."""

    ratio: Annotated[toml.Number, Field(ge=1.0, le=100.0)]
    """Wavelength along the lay over the wavelength across it."""
    direction: Angle = 0.0
    """Angle of ridges and grooves to the x axis, rad; it may be `"30 deg"`."""


class SyntheticSurface(toml.Settings):
    """A self-affine surface; see :func:`multiscale.micro.self_affine`."""

    rms_height: toml.Length | None = None
    """Root mean square height, m, or `rms_slope`."""
    rms_slope: Slope | None = None
    """Root mean square slope, or `rms_height`."""
    hurst_exponent: toml.Share
    """Hurst exponent: 0 rough at every scale, 1 smooth at small scales; often 0.8."""
    long_cutoff: toml.Length = Field(
        description="Longest wavelength, m; cells should be several wide."
    )
    short_cutoff: toml.Length
    """Shortest wavelength, m; it needs eight grid points or more."""
    roll_off: toml.Length | None = None
    """Wavelength above which the spectrum is flat, m; the longest if not given."""
    anisotropy: AnisotropySettings | None = None
    """Lay; the wavelengths above are measured across it. No lay if not given."""

    def _faults(self) -> Iterator[str]:
        if (self.rms_height is None) == (self.rms_slope is None):
            yield "give either rms_height or rms_slope"
        if self.short_cutoff > self.long_cutoff:
            yield (
                f"short_cutoff ({self.short_cutoff:g} m) must not be longer than long_cutoff "
                f"({self.long_cutoff:g} m)"
            )

    @property
    def longest_wave(self) -> float:
        """Longest wavelength in any direction, m."""
        return self.long_cutoff * (1.0 if self.anisotropy is None else self.anisotropy.ratio)

    @property
    def options(self) -> dict[str, Any]:
        """Options of :func:`multiscale.surfaces.self_affine`."""
        lay = self.anisotropy and Anisotropy(self.anisotropy.ratio, self.anisotropy.direction)
        return self.model_dump() | {"anisotropy": lay}


class InstrumentSurface(toml.Settings):
    """A measured map, cut into a window for each realisation."""

    file: Path
    """Instrument file of any format that SurfaceTopography reads, a NumPy array, or text with a
    matrix, or with points `x y z`."""
    channel: int | str | None = None
    """Number, from 0, or name of a channel; the only channel of heights if not given."""
    size: tuple[toml.Length, ...] | None = Field(None, min_length=1, max_length=2)
    """Edge lengths along x and y, or the length of a line scan, m, in place of the size in the
    file."""
    unit: UnitOfLength | None = None
    """Unit of the numbers in the file, such as `"um"`, if the file has no unit."""
    rotate: Angle = 0.0
    """Angle of a counter-clockwise rotation of the map before it is cut, rad; exact for multiples
    of 90 degrees, interpolated otherwise."""
    profile: Literal["isotropic", "one_directional"] | None = None
    """Surface made from a line scan: `isotropic` with its spectrum, or grooves along y with the
    scan across them."""
    detrend_order: toml.Count = Field(2, ge=0, le=2)
    """0 mean, 1 plane, 2 curvature of the map; also the plane of windows."""
    fill_undefined: bool = Field(False, description="Fills undefined points; refused otherwise.")
    spikes: Literal["keep", "remove"] = "keep"
    """`remove` fills points far above or below their neighbours, by the median test of
    `multiscale.surfaces.find_spikes`, and reports their number."""
    filled: toml.Share = Field(0.1, description="Largest share of filled points in a window.")
    periodic: Literal["mirror", "window"] = "mirror"
    """Whether a window is reflected at its edges (a quarter of the cell), or faded."""
    short_cutoff: toml.Length | None = None
    """Shortest wavelength, m; eight points of the grid of the cell if not given, so that another
    grid has another surface."""

    def _faults(self) -> Iterator[str]:
        quarters = self.rotate / (0.5 * pi)
        if self.profile == "isotropic" and self.rotate != 0.0:
            yield "rotate has no effect on isotropic surfaces; leave it out"
        if self.profile == "one_directional" and abs(quarters - round(quarters)) > 1e-9:
            yield (
                "rotate of a line scan must be a multiple of 90 degrees: only grooves along an "
                "edge of the cell are periodic"
            )


def _kind_of_surface(value: Any) -> str:
    named = value if isinstance(value, dict) else getattr(value, "__dict__", {})
    return "instrument" if "file" in named else "synthetic"


Conductivity = Annotated[float, toml.quantity("W/m/K"), Field(gt=0.0), toml.with_unit("W/m/K")]
ElectricalConductivity = Annotated[
    float, toml.quantity("S/m"), Field(gt=0.0), toml.with_unit("S/m")
]
Hardening = Annotated[float, toml.quantity("Pa"), toml.with_unit("Pa")]
Rough = Annotated[
    Annotated[SyntheticSurface, Tag("synthetic")] | Annotated[InstrumentSurface, Tag("instrument")],
    Discriminator(_kind_of_surface),
]


class CoatingSettings(toml.Settings):
    """One bonded layer of another material and constant thickness on a body; outermost first."""

    thickness: toml.Length = Field(description="Thickness, m.")
    youngs_modulus: toml.Pressure = Field(description="Young's modulus, Pa.")
    poissons_ratio: toml.Ratio = Field(description="Poisson's ratio.")
    hardness: toml.Pressure | None = None
    """Hardness, Pa, the largest local pressure of flat cells; if not given, the hardness of the
    layer below, or of the body."""


class RoughBody(toml.Settings):
    """A body of the interface."""

    youngs_modulus: toml.Pressure = Field(description="Young's modulus, Pa.")
    poissons_ratio: toml.Ratio = Field(description="Poisson's ratio.")
    surface: Rough | None = None
    """Synthetic or measured roughness; smooth if not given."""
    hardness: toml.Pressure | None = None
    """Hardness H of a metal, Pa; the softer body determines the interface. In flat cells H is the
    largest local pressure; in conforming cells H/2.8 is the flow stress at a plastic strain of .08.
    Elastic if not given."""
    hardening_modulus: Hardening | None = None
    """Slope of the yield stress, Pa, 0 to below H/.224; conforming cells only."""
    thermal_conductivity: Conductivity | None = None
    """Thermal conductivity, W/m/K; needed of both bodies for a conductance."""
    electrical_conductivity: ElectricalConductivity | None = None
    """Electrical conductivity, S/m; needed of both bodies for a conductance without films."""
    coating: tuple[CoatingSettings, ...] = ()

    @field_validator("hardening_modulus")
    @classmethod
    def _harden(cls, value: float | None) -> float | None:
        if value is not None and value < 0.0:
            raise ValueError(
                "must not be negative, or the metal softens and breaks in bands as thin as an "
                "element"
            )
        return value

    def _faults(self) -> Iterator[str]:
        if self.hardening_modulus is not None and self.hardness is None:
            yield "hardening_modulus needs a hardness, from which a metal yields"
        if self.hardness is not None and not (self.yield_stress or 0.0) > 0.0:
            hardening, given = (1e-9 * (v or 0.0) for v in (self.hardening_modulus, self.hardness))
            yield (
                f"a hardening_modulus of {hardening:g} GPa already gives more than the hardness of "
                f"{given:g} GPa, without any yield stress; give less than "
                f"{given / TABOR / INDENTED:.3g} GPa"
            )

    @property
    def surface_hardness(self) -> float | None:
        """Hardness of the outermost layer with a hardness, or of the body below, Pa."""
        given = [layer.hardness for layer in self.coating if layer.hardness is not None]
        return given[0] if given else self.hardness

    @property
    def stack(self) -> "tuple[Coating, ...]":
        """The coatings of a cell."""
        from multiscale.micro import Coating

        return tuple(
            Coating(layer.thickness, layer.youngs_modulus, layer.poissons_ratio)
            for layer in self.coating
        )

    @property
    def moduli(self) -> tuple[tuple[float, float], ...]:
        """Young's moduli, Pa, and Poisson's ratios, from the outermost layer to the body."""
        outer = [(layer.youngs_modulus, layer.poissons_ratio) for layer in self.coating]
        return (*outer, (self.youngs_modulus, self.poissons_ratio))

    @property
    def yield_stress(self) -> float | None:
        """Yield stress of conforming cells, Pa: H / 2.8 - 0.08 h, at .08 indented strain."""
        if self.hardness is None:
            return None
        return self.hardness / TABOR - INDENTED * (self.hardening_modulus or 0.0)

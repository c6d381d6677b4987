"""What a case may say of its two bodies: their surfaces, and what they are made of."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from multiscale.pipeline.toml_model import (
    Count,
    Length,
    Number,
    Pressure,
    Settings,
    quantity,
    with_unit,
)

__all__ = ["TABOR", "Body", "InstrumentSurface", "SyntheticSurface"]

TABOR, INDENTED = 2.8, 0.08
"""Hardness over flow stress, and plastic strain of that under a Vickers indenter (D. Tabor, The
Hardness of Metals, Oxford 1951)."""


class SyntheticSurface(Settings):
    """A self-affine surface; see :func:`multiscale.micro.self_affine`.

    Parameters
    ----------
    rms_height : quantity
        Root mean square height, m; this or ``rms_slope``.
    rms_slope : number
        Root mean square slope; this or ``rms_height``.
    hurst_exponent : number
        From 0 (rough at every scale) to 1 (smooth in the small); about 0.8 for many surfaces.
    long_cutoff : quantity
        Longest wavelength, m; a cell should be several of them wide.
    short_cutoff : quantity
        Shortest wavelength, m; it wants eight grid points or more.
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
        Instrument file of any format that SurfaceTopography reads; relative to the case file.
    detrend_order : int
        0 mean, 1 plane, 2 curvature; of the whole map, and the plane of each window.
    fill_undefined : bool
        Whether undefined points are filled; refused otherwise.
    filled : number
        Largest share of filled points in a window.
    periodic : {"mirror", "window"}
        How a window is made periodic: reflected (it covers a quarter of the cell) or faded along
        its edges.
    short_cutoff : quantity, optional
        Shortest wavelength kept, m; eight points of the cell's grid if not given, so that another
        grid has another surface.
    """

    file: Path
    detrend_order: Annotated[Count, Field(ge=0, le=2)] = 2
    fill_undefined: bool = False
    filled: Annotated[Number, Field(ge=0.0, le=1.0)] = 0.1
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
        Young's modulus, Pa.
    poissons_ratio : number
        Poisson's ratio.
    surface : table, optional
        Synthetic or measured roughness; smooth if not given.
    hardness : quantity, optional
        Hardness H of a metal, Pa; the softer body's counts. In flat cells the largest local
        pressure; in conforming ones H/2.8 is the flow stress at a plastic strain of .08. Elastic if
        not given.
    hardening_modulus : quantity, optional
        Rise of the yield stress with the plastic strain, Pa, at least 0 and below H/.224;
        conforming cells only.
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
    hardening_modulus: Annotated[float, quantity("Pa"), with_unit("Pa")] | None = None

    @field_validator("hardening_modulus")
    @classmethod
    def _harden(cls, value: float | None) -> float | None:
        if value is not None and value < 0.0:
            raise ValueError(
                "must not be negative, or the metal softens and breaks in bands as thin as an "
                "element"
            )
        return value

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.hardening_modulus is not None and self.hardness is None:
            raise ValueError("hardening_modulus needs a hardness, from which a metal yields")
        if self.hardness is not None and not (self.yield_stress or 0.0) > 0.0:
            hardening, given = (1e-9 * (v or 0.0) for v in (self.hardening_modulus, self.hardness))
            raise ValueError(
                f"a hardening_modulus of {hardening:g} GPa alone gives more than the hardness of "
                f"{given:g} GPa and leaves no yield stress; give less than "
                f"{given / TABOR / INDENTED:.3g} GPa"
            )
        return self

    @property
    def yield_stress(self) -> float | None:
        r"""Yield stress of conforming cells, Pa: :math:`\sigma_y = H/2.8 - 0.08\, h`.

        The indenter meets the stress to which its own plastic strain, of .08 in the mean, has
        raised the yield stress by the hardening modulus :math:`h`.
        """
        if self.hardness is None:
            return None
        return self.hardness / TABOR - INDENTED * (self.hardening_modulus or 0.0)

"""Friction of rubber at a temperature, from a law fitted to all of them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from multiscale.errors import CaseError
from multiscale.laws import BellFriction, wlf_shift
from multiscale.upscaling.reading import fitted_laws, require_law

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["friction_at", "frictions_at"]


def friction_at(law: "xr.Dataset", temperature: float) -> BellFriction:
    """Friction law at a temperature, K, from a fitted bell; other laws are refused."""
    return frictions_at(law, temperature, [None])[0]


def frictions_at(
    law: "xr.Dataset", temperature: float, samples: Sequence[int | None]
) -> list[BellFriction]:
    """Make the mean law (None) and samples of it; see :func:`friction_at`."""
    bells = fitted_laws(law, samples)
    if not isinstance(bells[0], BellFriction):
        raise CaseError(
            f"the dataset holds a law of the family {law.attrs.get('family')!r}, expected a bell "
            f"of friction; pass the law of a run of rubber on a road"
        )
    names = ("reference_temperature", "wlf_c1", "wlf_c2")
    require_law(law, *names)
    shift = wlf_shift(temperature, *(float(law.attrs[name]) for name in names))
    return [replace(bell, peak_speed=bell.peak_speed / shift) for bell in bells]

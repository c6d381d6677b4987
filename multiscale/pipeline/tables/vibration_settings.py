"""The table of a case that asks for frequency and damping of its bodies."""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, PrivateAttr, field_validator, model_validator

from multiscale import macro
from multiscale.pipeline.tables.toml_model import (
    Count,
    Length,
    Number,
    Positive,
    Quick,
    Settings,
    Share,
    at_most,
    must_rise,
)

FEW = 3  # amplitudes of quick runs, at most


def _some(_: Settings, values: tuple[float, ...]) -> tuple[float, ...]:
    """Return a few values, evenly spread."""
    places = np.linspace(0, len(values) - 1, min(FEW, len(values))).round().astype(int)
    return tuple(values[place] for place in places)


SOME = Quick(_some)

COARSENING = 2.0
"""Exponent by which the largest ratio of neighbouring amplitudes grows in coarser paths."""

RATIO = 1.5  # largest ratio of neighbouring amplitudes of a loading curve


class VibrationSettings(Settings):
    """Modes of the bodies about their preload, and their amplitudes.

    The steps of `[statics]` are the preload. Every body has a `density`; supports may leave the
    structure as a whole free.
    """

    modes: Annotated[tuple[Positive, ...], Quick(lambda _, modes: modes[:1])] = Field(
        (1,), min_length=1
    )
    """Numbers of the modes, from 1, in the order of their frequencies; rigid motions do not
    count."""
    amplitudes: Annotated[tuple[Length, ...], SOME] = ()
    """Amplitudes as the largest displacement of a node in the mode, m, rising."""
    modal_amplitudes: Annotated[tuple[Annotated[Number, Field(gt=0.0)], ...], SOME] = ()
    """Amplitudes of shapes of unit modal mass, kg^1/2 m, rising; they or `amplitudes` are given."""
    material_damping: Share = 0.0
    """Share of critical damping that the bodies give every mode."""
    cycle: Literal["masing", "full"] = "masing"
    """Loss of a cycle by Masing's rule from the loading curve, in both directions, or from a full
    cycle at every amplitude. Where contact opens, or the preload leaves shear, full cycles are
    solved in any case."""
    steps: Annotated[Positive, at_most(4)] = 10
    """Steps from the middle of a full cycle to its amplitude."""
    preload_friction: bool = True
    """Whether interfaces have friction while the preload is brought up."""
    slabs: Annotated[Count, Field(ge=8, le=10_000), at_most(192)] = 512
    """Slabs of the beds of sliders: with few slabs the small slip of small amplitudes is lost."""

    _whole: "VibrationSettings | None" = PrivateAttr(None)

    _rise = field_validator("amplitudes", "modal_amplitudes")(must_rise)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if bool(self.amplitudes) == bool(self.modal_amplitudes):
            given = "both are given" if self.amplitudes else "neither is given"
            raise ValueError(f"either amplitudes or modal_amplitudes should be given, and {given}")
        if twice := [mode for mode in self.modes if self.modes.count(mode) > 1]:
            raise ValueError(f"modes should name mode {twice[0]} once, got {list(self.modes)}")
        return self

    def reach(
        self, largest: np.ndarray, *, coarse: bool = False
    ) -> "dict[int, macro.vibration.Amplitudes]":
        """Return the modal amplitudes of the modes, counted from 0."""
        given = np.array(self.modal_amplitudes or self.amplitudes)
        return {
            mode - 1: macro.vibration.Amplitudes(
                tuple((given if self.modal_amplitudes else given / largest[mode - 1]).tolist()),
                full_cycle=self.cycle == "full",
                ratio=RATIO**COARSENING if coarse else RATIO,
                steps=max(1, self.steps // 2) if coarse else self.steps,
            )
            for mode in self.modes
        }

    def smaller(self) -> Self:
        """Return the first mode at a few amplitudes, of beds of fewer slabs."""
        small = super().smaller()
        small._whole = self
        return small

    def left_out(self) -> str:
        """Report the modes and amplitudes that a quick run leaves out; empty if it has all."""
        if self._whole is None:
            return ""
        modes = [str(mode) for mode in self._whole.modes if mode not in self.modes]
        few, all_of = (
            len(settings.amplitudes or settings.modal_amplitudes)
            for settings in (self, self._whole)
        )
        omitted = [f"mode{'s' if len(modes) > 1 else ''} {', '.join(modes)}"] if modes else []
        omitted += [f"{all_of - few} of {all_of} amplitudes"] if few < all_of else []
        return f"--quick leaves out {' and '.join(omitted)}." if omitted else ""

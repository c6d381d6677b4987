"""What a case may say of rough joints: their cut and solver, their law, their loading."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, model_validator

from multiscale.errors import CaseError
from multiscale.io import open_law
from multiscale.laws import Damaged, NormalLaw, Sliders
from multiscale.macro import LatinMethod
from multiscale.macro.substructures import JointLoading
from multiscale.pipeline.toml_model import (
    Factor,
    Natural,
    Number,
    Positive,
    Pressure,
    Settings,
    Tolerance,
)

if TYPE_CHECKING:
    import xarray as xr

    from multiscale.macro.substructures import ProcessGroup

__all__ = ["Damage", "JointLawSettings", "Loading", "Substructures"]

QUICK_STEPS = 2
"""Load steps to the amplitude, at most."""

LEAST, MOST = 0.1, 3.0
"""Pressures of a joint that count, relative to the least and the largest preload."""

SLABS, FEW_SLABS = 48, 8
"""Slabs of the law of a joint under cycles, whose loss is a small difference, and of one that is
only pressed: their shear errs by up to .5 and 8 % of the friction limit; see :class:`Sliders`."""

Damage = Annotated[Number, Field(ge=0.0, lt=1.0)]


class Substructures(Settings):
    """The cut, and the solver of the parts; see :func:`multiscale.macro.solve_latin`."""

    parts: tuple[Positive, Positive] = Field(
        (1, 1), description="Substructures along x and y, of every body."
    )
    coarse: bool = Field(
        True, description="Whether a coarse problem balances interface resultants."
    )
    tolerance: Tolerance = Field(1e-8, description="Relative residual of a solved step.")
    max_iterations: Positive = Field(400, description="Largest number of iterations of a step.")
    homogenise: bool = Field(
        False,
        description="Writes the stiffness of substructures against their interface resultants, "
        "before and after slackening, to `NAME-homogenised.nc`; see `multiscale.macro.homogenise`.",
    )

    @property
    def count(self) -> int:
        """Substructures of a body, or of a grid."""
        return self.parts[0] * self.parts[1]

    def stop(self, team: "ProcessGroup | None") -> dict[str, Any]:
        """When the solver stops, and who shares its work."""
        return {"tolerance": self.tolerance, "max_iterations": self.max_iterations, "team": team}

    def method(self, team: "ProcessGroup | None") -> LatinMethod:
        """How elastic bodies are solved."""
        return LatinMethod(self.parts, self.coarse, **self.stop(team))

    def quick(self) -> Self:
        """Return a cut into two parts each way, at most."""
        return self.model_copy(update={"parts": tuple(min(2, number) for number in self.parts)})


class JointLawSettings(Settings):
    """The law of the joints: a fitted normal law with friction."""

    law: Path | None = Field(
        None, description="Dataset of a law from a run or fit; needless if the command names one."
    )
    friction: Factor = Field(description="Coefficient of Coulomb's law.")
    stiffness_ratio: Number = Field(
        0.8, gt=0.0, description="Tangential over normal stiffness, of springs slipping in turn."
    )
    damage: tuple[Damage, ...] = Field(
        (),
        description="Damage of joints from below: each carries 1 - D of the law; 0 if not given.",
    )
    extrapolate: bool = Field(
        False,
        description="Whether answers stand where more than 5 % of the load of a joint lies beyond "
        "a factor of 2 outside the pressures of the law; they are unknown otherwise.",
    )

    def open(self) -> "xr.Dataset":
        """Open the normal law.

        Raises
        ------
        MultiscaleError
            If there is none, or it is refused.
        """
        if self.law is None:
            raise CaseError(
                "the structure has joints but no law: name a file by [joint] law or by --law, such "
                "as the interface_law.nc of a run"
            )
        return open_law(self.law)

    def build(self, sound: NormalLaw, joints: int, loading: "Loading") -> list[Sliders]:
        """Make the law of every joint: the sound one, less its damage, with friction."""
        return [
            Sliders(
                Damaged(sound, D) if D else sound,
                self.friction,
                self.stiffness_ratio,
                pressures=loading.joint_pressures,
                slabs=loading.slabs,
            )
            for D in self.damage or (0.0,) * joints
        ]


class Loading(Settings):
    """Preloads, then cycles; see :class:`multiscale.macro.substructures.JointLoading`."""

    preloads: tuple[Pressure, ...] = Field(
        min_length=1, description="Pressures on the pressed face, Pa; the last one stays."
    )
    shear: Pressure | None = Field(
        None, description="Amplitude of the shear on the sheared face, Pa."
    )
    cycles: Natural = Field(0, description="Closed cycles after the first loading.")
    steps: Positive = Field(10, description="Load steps from zero to the amplitude.")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.shear is None) != (self.cycles == 0):
            raise ValueError("give both shear and cycles, or neither")
        return self

    @property
    def joint_pressures(self) -> tuple[float, float]:
        """Pressures for which the law of the joints is fine, Pa."""
        return LEAST * min(self.preloads), MOST * max(self.preloads)

    @property
    def slabs(self) -> int:
        """Slabs of the law of the joints: the loss of a cycle is a small difference."""
        return SLABS if self.cycles else FEW_SLABS

    def build(self) -> JointLoading:
        """Make the loading."""
        return JointLoading(self.preloads, self.shear or 0.0, self.cycles, self.steps)

    def quick(self) -> Self:
        """Return one cycle of few steps."""
        return self.model_copy(
            update={"cycles": min(1, self.cycles), "steps": min(QUICK_STEPS, self.steps)}
        )

"""Tables of bodies under cycles: their vibration, their fatigue, and cracks that grow."""

from collections.abc import Iterator
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, PrivateAttr

from multiscale import macro
from multiscale.errors import CaseError
from multiscale.micro.damage import Cavities, Microcracks
from multiscale.micro.damage.fatigue import FatigueMaterial
from multiscale.pipeline.tables import toml_model as toml
from multiscale.pipeline.tables.joint_settings import Slabs
from multiscale.pipeline.tables.rve_settings import RveSettings

FEW = 3  # amplitudes of quick runs, at most


def _some(_: toml.Settings, values: tuple[float, ...]) -> tuple[float, ...]:
    """Return a few values, evenly spread."""
    places = np.linspace(0, len(values) - 1, min(FEW, len(values))).round().astype(int)
    return tuple(values[place] for place in places)


SOME = toml.Quick(_some)

COARSENING = 2.0  # exponent of the largest ratio of neighbouring amplitudes in coarser paths
RATIO = 1.5  # largest ratio of neighbouring amplitudes of a loading curve


class VibrationSettings(toml.Settings):
    """Modes of the bodies about their preload, and their amplitudes.

    The steps of `[statics]` are the preload. Every body needs a `density`; the structure may have
    rigid motions.
    """

    modes: Annotated[tuple[toml.Positive, ...], toml.Quick(lambda _, modes: modes[:1])] = Field(
        (1,), min_length=1
    )
    """Numbers of the modes, from 1, in the order of their frequencies, without rigid motions."""
    amplitudes: Annotated[toml.Rising[toml.Length], SOME] = ()
    """Amplitudes as the largest displacement of a node in the mode, m, rising."""
    modal_amplitudes: Annotated[toml.Rising[Annotated[toml.Number, Field(gt=0.0)]], SOME] = ()
    """Amplitudes of shapes of unit modal mass, kg^1/2 m, rising, in place of `amplitudes`."""
    material_damping: toml.Share = 0.0
    """Share of critical damping of every mode by the bodies."""
    cycle: Literal["masing", "full"] = "masing"
    """Loss of a cycle by Masing's rule from the loading curve in both directions, or from a full
    cycle at every amplitude. If contact opens, or shear remains after the preload, full cycles are
    always solved."""
    steps: Annotated[toml.Positive, toml.at_most(4)] = 10
    """Steps from the middle of a full cycle to its amplitude."""
    preload_friction: bool = True
    """Whether interfaces have friction during the preload."""
    slabs: Annotated[Slabs, toml.at_most(192)] = 512
    """Slabs of the beds of sliders; small amplitudes with little slip need many."""

    _whole: "VibrationSettings | None" = PrivateAttr(None)

    def _faults(self) -> Iterator[str]:
        if bool(self.amplitudes) == bool(self.modal_amplitudes):
            given = "both are given" if self.amplitudes else "neither is given"
            yield f"either amplitudes or modal_amplitudes should be given, and {given}"
        if twice := [mode for mode in self.modes if self.modes.count(mode) > 1]:
            yield f"modes should name mode {twice[0]} once, got {list(self.modes)}"

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
        """Report the modes and amplitudes that a quick run leaves out; empty if there are none."""
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


Modulus = Annotated[float, toml.quantity("Pa"), Field(ge=0.0), toml.with_unit("Pa")]
Deviation = Annotated[toml.Number, Field(ge=0.0, lt=0.5)]


class FatigueSettings(toml.Settings):
    """Life of a body under the cycles of its structure, by the two-scale model in every element.

    Inclusions of each element flow above the fatigue limit, are damaged and crack.
    """

    body: str | None = None
    """Name of the body; needed if there are several."""
    fatigue_limit: toml.Pressure
    """Yield stress of the inclusions, Pa; no inclusion cracks at smaller amplitudes."""
    strength: toml.Pressure
    """Static strength, Pa; a larger von Mises stress of an element is refused."""
    damage_strength: toml.Pressure = Field(description="Strength S of the damage law, Pa.")
    damage_exponent: Annotated[toml.Number, Field(gt=0.0)] = 1.0
    """Exponent s of the damage law."""
    hardening: Modulus = Field(0.0, description="Kinematic hardening C of the inclusions, Pa.")
    threshold: toml.Factor = 0.0
    """Accumulated plastic strain p_D at which damage begins."""
    critical_damage: Annotated[toml.Share, Field(gt=0.0)] = 0.3
    """Damage D_c at which an inclusion cracks."""
    closure: toml.Share = Field(1.0, description="Share h of the damage that acts in compression.")
    feedback: bool = True
    """Whether the damage of an inclusion changes its stress."""
    scatter: Deviation = 0.0
    """Standard deviation of the logarithm of the fatigue limit among the inclusions of an element;
    with 0 an element has a single inclusion."""
    part_deviation: Deviation | None = None
    """Relative standard deviation of the fatigue limit from part to part, for the interval of the
    next part."""
    limit_error: Deviation | None = None
    """Relative standard error of the mean fatigue limit, for both intervals."""
    tolerance: toml.Tolerance = 0.05
    """Bound on the relative error of the change of damage over a jump of cycles between two solves
    of the structure."""
    max_cycles: Annotated[toml.Number, Field(ge=1.0, le=1e12)] = 1e9
    """Number of cycles up to which the life is followed."""

    def _faults(self) -> Iterator[str]:
        if self.strength <= self.fatigue_limit:
            yield (
                f"strength is {1e-6 * self.strength:g} MPa and fatigue_limit "
                f"{1e-6 * self.fatigue_limit:g} MPa; fatigue is damage between both, so that the "
                f"strength must be larger"
            )

    def material(self, youngs_modulus: float, poissons_ratio: float) -> FatigueMaterial:
        """Return the two-scale material of a body with these moduli, Pa and dimensionless."""
        names = ("fatigue_limit", "damage_strength", "damage_exponent", "hardening", "threshold")
        names += ("critical_damage", "closure", "feedback")  # type: ignore[assignment]
        parameters = {name: getattr(self, name) for name in names}
        return FatigueMaterial(youngs_modulus, poissons_ratio, **parameters)


UNIT = "Pa*m^0.5"
Toughness = Annotated[float, toml.quantity(UNIT), Field(gt=0.0), toml.with_unit(UNIT)]


class GrowthSettings(toml.Settings):
    """Penny-shaped cracks of [rve] that grow where K_I reaches K_Ic, under tension along an axis.

    The body of a structure cracks by their softening law.
    """

    toughness: Toughness
    """Toughness K_Ic where a crack begins to grow, such as `"0.5 MPa*m^0.5"`."""
    rise: toml.Factor = 0.0
    """Relative rise of the toughness by grains that bridge the faces of a crack."""
    bridging: toml.Length | None = None
    """Growth of a crack over which the toughness rises, m; together with `rise`."""
    pull: Literal["x", "y", "z"] = Field("z", description="Axis of the tension.")
    through: bool = False
    """Whether a crack that reaches another crack continues to grow as an isolated crack; otherwise
    its volume has no softening law."""

    def _faults(self) -> Iterator[str]:
        if bool(self.rise) != (self.bridging is not None):
            yield "rise and bridging belong together; give both or neither"

    def volumes(self, rve: RveSettings) -> list[tuple[float, Microcracks]]:
        """Return the size over the whole volume, and the cracks, of all periodic volumes."""
        solid = {name: getattr(rve, name) for name in ("youngs_modulus", "poissons_ratio")}
        solid |= {"toughness": self.toughness, "rise": self.rise}
        solid |= {"bridging": self.bridging} if self.bridging else {}
        volumes = []
        for share, volume in rve.jobs():
            if not isinstance(volume, Cavities):
                raise CaseError("[growth] takes the cracks of [rve], and an image has no cracks")
            if volume.periodic:  # smaller volumes cut from a listed volume contain cut cracks
                try:
                    volumes.append((share, Microcracks.of(volume, **solid)))
                except CaseError as error:
                    raise CaseError(f"[growth] {error}") from error
        return volumes

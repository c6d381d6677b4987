"""Tables between the bodies of a case, and on them: interfaces, stated laws, bolts, loads."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from multiscale import macro
from multiscale.errors import CaseError
from multiscale.io.csv_tables import read_table
from multiscale.laws import Exponential, Tabulated
from multiscale.pipeline.tables import toml_model as toml
from multiscale.pipeline.tables.grain_settings import SlidingSpeed
from multiscale.pipeline.tables.joint_settings import (
    RUN_QUICK,
    Damage,
    JointLaw,
    LawError,
    StatedAsperities,
)
from multiscale.pipeline.tables.meshed_bodies import LengthUnit, Name
from multiscale.pipeline.tables.structure_kind import Face
from multiscale.units import to_si

if TYPE_CHECKING:
    from skfem import Mesh


GROUNDED = "ground"  # first side of an interface with the rigid ground
PLANE = 1e-6  # spread of the unit normals of a plane face


def _read_component(value: object, *, unit: str) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and value == 0:
        return 0.0
    try:
        return to_si(value, unit)
    except CaseError as error:
        raise ValueError(str(error)) from error


Stress = Annotated[
    float, BeforeValidator(partial(_read_component, unit="Pa")), toml.with_unit("Pa")
]
Newton = Annotated[float, BeforeValidator(partial(_read_component, unit="N")), toml.with_unit("N")]
Size = Annotated[float, toml.quantity("N", uncertain=True), Field(gt=0.0), toml.with_unit("N")]
Stiffness = Annotated[float, toml.quantity("N/m"), Field(gt=0.0), toml.with_unit("N/m")]
UncertainStiffness = Annotated[
    float, toml.quantity("Pa/m", uncertain=True), Field(gt=0.0), toml.with_unit("Pa/m")
]


class StatedLaw(toml.Settings):
    """A normal law without cells: the pressure p_c exp(-g/u_0) at the gap g."""

    pressure_scale: toml.UncertainPressure = Field(description="Pressure p_c at zero gap, Pa.")
    decay_length: toml.UncertainLength = Field(description="Decay length u_0 of the pressure, m.")
    pressures: Annotated[tuple[toml.Pressure, toml.Pressure], toml.RISE]
    """Pressures between which the law is valid, Pa, rising."""

    def build(self) -> Exponential:
        """Return the law."""
        return Exponential(self.pressure_scale, self.decay_length, pressure_range=self.pressures)


class LinearLaw(toml.Settings):
    """A normal law without cells: the pressure K a at the overclosure a, and no tension."""

    stiffness: UncertainStiffness = Field(description="Stiffness K of the interface, Pa/m.")
    pressures: ClassVar[tuple[float, float]] = (1.0, 1e9)
    """Pressures of the bed of sliders, Pa; its stiffness is the same at all pressures."""

    def build(self) -> Tabulated:
        """Return the law."""
        return Tabulated(np.array([0.0, self.stiffness]), np.array([0.0, -1.0]))


class StatedGap(toml.Settings):
    """The initial gap of an interface, added to the gap of its law."""

    form: Literal["map"] = Field(description="Origin of the gap.")
    file: Path
    """Table with the columns `x`, `y` and `gap`: points in the plane of the interface, along the
    axes of the structure, and gaps, `nan` in holes."""
    unit: LengthUnit = Field(description='Length of one unit of the table, such as `"mm"`.')

    def build(self) -> "macro.GapMap":
        """Read the map."""
        table = read_table(self.file, lambda name: float)  # holes are nan
        if missing := sorted({"x", "y", "gap"} - set(table)):
            raise CaseError(
                f"{self.file}: no column {missing[0]!r}; a map of a gap has x, y and gap"
            )
        x, y, gap = (self.unit * np.array(table[name], dtype=float) for name in ("x", "y", "gap"))
        return macro.GapMap(np.column_stack([x, y]), gap, str(self.file))


class BodyInterface(toml.Settings):
    """An interface between two named faces; their meshes need not match."""

    sides: tuple[str, str]
    """Both faces, as `"BODY.FACE"`; the first may be `"ground"`."""
    law: Path | None = None
    """Law of this interface: a dataset, the folder of a run, or a case, which is run in a separate
    folder; or a table of `pressure` and `overclosure` in a `.csv` file; if not given, the law of
    the cells or of `[interface]`."""
    law_error: LawError | None = None
    """Relative half-width of the 95 % interval of overclosure and stiffness of a table, such as
    `"10 %"`; the error is unknown if not given."""
    exponential: StatedLaw | None = None
    """Stated normal law, in place of `law`; needs `friction`."""
    linear: LinearLaw | None = None
    """Stated normal law of constant stiffness, as `exponential`."""
    asperities: StatedAsperities | None = None
    """Statistics of asperities, in place of `law`; they need `friction`. Asperities yield and slip
    in the order of their heights."""
    gap: StatedGap | None = None
    """Initial gap over the interface; uniform if not given."""
    quick: Annotated[bool, RUN_QUICK] = False
    """Whether a case that `law` names is run `--quick`."""
    speed: SlidingSpeed | None = None
    """Speed of sliding of a law of grains, m/s, if not the value of `[interface]`."""
    friction: toml.UncertainFactor | None = None
    """Coefficient of friction, if not the value of `[interface]` or the law."""
    stiffness_ratio: Annotated[toml.UncertainNumber, Field(gt=0.0)] | None = None
    """Tangential over normal stiffness, if not the value of `[interface]` or the law."""
    damage: Damage = Field(0.0, description="Damage D of the interface, with its law times 1 - D.")
    surface_damage: bool = False
    """Whether the damage D(n) of sections of the representative volumes of its bodies, normal to
    the interface, counts too: each gives the law a factor 1 - D(n)."""

    def _faults(self) -> Iterator[str]:
        stated = self.exponential, self.linear, self.asperities
        if sum(law is not None for law in (self.law, *stated)) > 1:
            yield "an interface takes one of law, exponential, linear and asperities"
        if self.law_error is not None and self.law is None:
            yield "law_error belongs to a table in law, and the interface has no law"

    @property
    def is_stated(self) -> bool:
        """Whether the case itself states the normal law."""
        return any((self.exponential, self.linear, self.asperities))

    @property
    def faces(self) -> tuple[str, ...]:
        """Faces of bodies, without the ground."""
        return self.sides[self.sides[0] == GROUNDED :]

    @property
    def name(self) -> str:
        """Both faces in words."""
        return " on ".join(reversed(self.sides))

    def over(self, shared: JointLaw | None) -> JointLaw:
        """Return the keys of ``[interface]``, if given, replaced by the keys of this interface."""
        names = ("law", "law_error", "speed", "friction", "stiffness_ratio")
        keys = {name: getattr(self, name) for name in names}
        given = {name: value for name, value in keys.items() if value is not None}
        if self.law is not None:  # of this law, whatever [interface] states
            of_law = {"law_error": self.law_error, "quick": self.quick, "speed": self.speed}
            given |= of_law
        return (shared or JointLaw()).model_copy(update=given)


class BodyBolt(toml.Settings):
    """A bolt between two opposite faces along x, y or z.

    Its washers are rigid and tilt, and it carries no shear. A meshed bolt is part of both bodies,
    and bends and shears with them.
    """

    sides: tuple[str, str]
    """Faces under head and nut, as `"BODY.FACE"`, of the size of the washers; or both faces of a
    cut across a meshed shank."""
    meshed: bool = False
    """Whether the meshes of the bodies contain the bolt, with a cut across its shank. Both faces of
    the cut have equal displacements across the axis; along the axis acts the constant preload."""
    preload: Size = Field(description="Force of the bolt at the factor 1 of `preload`, N.")
    diameter: toml.Length | None = Field(None, description="Diameter of the shank, m.")
    length: toml.Length | None = None
    """Length of the shank, m; the distance of its washers if not given."""
    youngs_modulus: toml.Pressure = Field(210e9, description="Young's modulus of the shank, Pa.")
    stiffness: Stiffness | None = None
    """Axial stiffness of the shank, N/m, in place of its diameter."""

    def _faults(self) -> Iterator[str]:
        if self.meshed and (self.diameter or self.stiffness or self.length):
            yield "a meshed bolt must not have a diameter, length or stiffness"
        if not self.meshed and (self.diameter is None) == (self.stiffness is None):
            yield "a bolt takes either the diameter of its shank or its stiffness"
        if len({side.partition(".")[0] for side in self.sides}) == 1:
            yield (
                f"a bolt between two faces of one body clamps nothing, got {self.sides[0]!r} and "
                f"{self.sides[1]!r}; name a face of another body in sides"
            )

    def build(
        self, sides: tuple[int, int], boundaries: tuple[str, str], bodies: "Sequence[macro.Body]"
    ) -> "tuple[macro.Bolt, str]":
        """Build the bolt between faces of bodies; return it and a sentence on faces and shank."""
        bolt = macro.Bolt(sides, boundaries, self.stiffness or 1.0, self.preload)
        description = " to ".join(self.sides)
        head, nut = bolt.washers(bodies)
        if self.diameter is None:
            return bolt, description
        assert head.point is not None
        assert nut.point is not None
        length = self.length or abs(nut.point[head.axis] - head.point[head.axis])
        between = "" if self.length else " between its washers"
        description += (
            f", shank of {1e3 * length:.4g} mm{between} and {1e-9 * self.youngs_modulus:.4g} GPa"
        )
        k = macro.shank_stiffness(self.diameter, length, self.youngs_modulus)
        return replace(bolt, stiffness=k), description


class NamedLoad(toml.Settings):
    """A load on a face, with a name for the path: a traction, a force or a pressure."""

    name: Name = Field(description="Name of the load.")
    face: str = Field(description='Loaded face, as `"BODY.FACE"`.')
    traction: tuple[Stress, Stress, Stress] | None = None
    """Force per area along x, y and z at the factor 1, Pa."""
    force: tuple[Newton, Newton, Newton] | None = None
    """Resultant along x, y and z, uniformly distributed, at the factor 1, N."""
    pressure: Stress | None = None
    """Pressure on a plane face at the factor 1, Pa."""

    def _faults(self) -> Iterator[str]:
        given = [value for value in (self.traction, self.force, self.pressure) if value is not None]
        if len(given) != 1:
            yield "a load is either a traction, a force or a pressure"
        if not np.any(given[0]):
            yield "the load is zero"

    def traction_on(self, mesh: "Mesh", boundary: str) -> tuple[np.ndarray, float]:
        """Return the traction at the factor 1, Pa, and the area of the face, m²."""
        face = Face.at(mesh, boundary)
        if self.force is not None:
            return np.array(self.force) / face.area, face.area
        if self.traction is not None:
            return np.array(self.traction), face.area
        if np.linalg.norm(face.normal) < 1.0 - PLANE:
            raise CaseError(
                f"the load {self.name} is a pressure on {self.face}, which is not plane; give its "
                f"traction or force"
            )
        return -float(self.pressure or 0.0) * face.normal, face.area

"""Tables of cells in a case: cells, ensemble, shear, law, measured joints, sliding and accuracy."""

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, Strict, field_validator

from multiscale.errors import CaseError
from multiscale.micro.damage import Cavities, Recipe
from multiscale.pipeline.tables import toml_model as toml
from multiscale.pipeline.tables.toml_model import quantity, with_unit
from multiscale.units import readable
from multiscale.upscaling import MeasuredJoint, read_measured, read_vibration
from multiscale.upscaling.measured.vibrations import Structure
from multiscale.upscaling.sampling import FEWEST_PAIRS, FEWEST_REALISATIONS
from multiscale.upscaling.shear_fit import FEWEST_BELOW

ABSENT: Any = None  # default of optional tables, which are read only if given
POINTS_PER_WAVE = 8  # grid points per shortest wavelength of a map without a cut-off

Viscosity = Annotated[float, quantity("Pa*s"), Field(gt=0.0), with_unit("Pa*s")]
Points = Annotated[toml.Count, Field(ge=4, le=8192, multiple_of=2)]

HALVED = toml.Quick(lambda _, points: tuple(max(4, 2 * ((n + 2) // 4)) for n in points))
MIDDLE = toml.Quick(lambda _, pressures: pressures[len(pressures) // 2 :][:1])
"""Half of the points of a grid, and a single pressure, in quick cases."""


class GridSettings(toml.Settings):
    """A rectangle of a surface, and its grid."""

    size: tuple[toml.Length, toml.Length] = Field(description="Edge lengths along x and y, m.")
    points: Annotated[tuple[Points, Points], HALVED] = Field(
        description="Grid points along x and y."
    )

    @property
    def spacing(self) -> float:
        """Largest distance of neighbouring points, m."""
        return max(edge / n for edge, n in zip(self.size, self.points, strict=True))

    @property
    def scope(self) -> str:
        """Short description of the cases of the same run folder."""
        return f"{self.points[0]} x {self.points[1]} points"

    def caution_wavelength(self, shortest: float | None, name: str, needs: str) -> Iterator[str]:
        """Caution against the shortest wavelength of a surface, m, with too few points."""
        if shortest is not None and shortest < 0.99 * POINTS_PER_WAVE * self.spacing:
            yield (
                f"the shortest wavelength of {name} has {shortest / self.spacing:.1f} points; "
                f"{needs} {POINTS_PER_WAVE} or more"
            )


def doubt_scatter(realisations: int) -> Iterator[str]:
    """Caution against realisations that are too few for bands."""
    if realisations < FEWEST_REALISATIONS:
        yield (
            f"{realisations} realisation(s) are too few for the scatter: there are no bands below "
            f"{FEWEST_REALISATIONS}"
        )


class VolumeSettings(toml.Settings):
    """Elastic moduli of a named volume of the mesh of a cell."""

    youngs_modulus: toml.Pressure = Field(description="Young's modulus of the volume, Pa.")
    poissons_ratio: toml.Ratio = Field(description="Poisson's ratio of the volume.")


class CellPores(toml.Settings):
    """Spherical pores below the surface of a mesh, different in every realisation.

    Pores lie entirely between the base and the cover, so that their share of the layer is smaller
    than the porosity.
    """

    porosity: toml.Number = Field(
        gt=0.0, lt=1.0, description="Volume fraction of pores in the depth."
    )
    radius: toml.Length = Field(description="Median radius of the pores, m.")
    spread: toml.Factor = Field(
        0.0, description="Standard deviation of the logarithm of their radii."
    )
    cover: toml.Length = Field(
        description="Solid between the pores and the mean plane of the surface, m."
    )

    def draw(self, size: tuple[float, float, float], seed: int) -> Cavities:
        """Draw the pores of a layer of a size, m."""
        recipe = Recipe(self.porosity, self.radius, self.spread)
        drawn = []
        for pores in recipe.draw(size, seed).bodies:
            low, high = (pores.centre[:, 2] + s * pores.reach[:, 2] for s in (-1.0, 1.0))
            whole = np.flatnonzero((low >= 0.0) & (high <= size[2] - self.cover))
            drawn.append(pores.take(whole, np.zeros(3)))
        if not any(len(pores.centre) for pores in drawn):
            cover, depth = (readable(f"{length:.4g} m") for length in (self.cover, size[2]))
            raise CaseError(
                f"no pore of [cell.pores] fits whole below a cover of {cover} in a depth of "
                f"{depth}; make cover smaller, or the cell deeper"
            )
        return Cavities(size, drawn)


class CellSettings(GridSettings):
    """The representative surface element."""

    depth: toml.Length | None = None
    """Depth of the layer, m; the longer edge if not given."""
    layers: toml.Count = Field(12, ge=2, le=1000, description="Layers of elements over the depth.")
    geometry: Literal["conforming", "flat", "mesh"] = "conforming"
    """`conforming`: the mesh follows the surface; `flat`: the surface is the gap of a flat layer
    (fast, for small slopes); `mesh`: finite elements of any kind."""
    slope_order: Literal[1, 2] = 1
    """Order of the error of flat cells in the slope, relative to conforming cells: 2 expands their
    compliance, in six transforms instead of two."""

    element: Literal["hex8", "hex27", "tet4", "tet10"] | None = None
    """Element of a mesh, by its number of nodes; `"hex8"` if not given. Elements of second order
    need multiples of four points."""
    mesh: Path | None = None
    """File of gmsh, or of a format that meshio reads, with the mesh of body 1 in place of a
    surface. The mesh fills the cell along x and y; overhangs and pores are allowed."""
    unit: toml.Length | None = Field(None, description="Length of the unit of the file `mesh`, m.")
    contact_face: str | None = None
    """Name of the contact face in the file `mesh`; `"top"` if not given."""
    base_face: str | None = None
    """Name of the clamped face in the file `mesh`; `"bottom"` if not given."""
    volumes: dict[str, VolumeSettings] | None = None
    """Moduli of all named volumes in the file `mesh`."""
    sides: Literal["periodic", "sliding", "displacement", "traction"] | None = None
    """Condition on the sides of a mesh: `periodic` if not given, `sliding` in their planes, or
    uniform `displacement` or `traction`, an upper and a lower bound."""
    pores: CellPores | None = None

    @property
    def given_depth(self) -> float:
        """Depth of the layer, m."""
        return self.depth if self.depth is not None else max(self.size)

    def _faults(self) -> Iterator[str]:
        if self.slope_order != 1 and self.geometry != "flat":
            yield (
                "slope_order belongs to flat cells, as conforming cells follow the surface; leave "
                'it out, or set geometry = "flat"'
            )
        of_file = ("unit", "contact_face", "base_face", "volumes")
        of_mesh = ("element", "mesh", "sides", "pores", *of_file)
        given = [name for name in of_mesh if getattr(self, name) is not None]
        if self.geometry != "mesh" and given:
            yield (
                f'{given[0]} is not a key of {self.geometry} cells; set geometry = "mesh", or '
                f"leave it out"
            )
        stray = [name for name in of_file if name in given]
        if self.mesh is None and stray:
            yield f"{stray[0]} describes a mesh file; give the file by mesh"
        if self.mesh is not None and self.depth is not None:
            yield "the file mesh determines the depth; leave out depth"
        if self.mesh is not None and self.pores is not None:
            yield "the file mesh determines the pores; leave out [cell.pores]"
        if self.pores is not None and self.pores.radius < 1.5 * self.spacing:
            yield (
                f"pores with a radius of {self.pores.radius:.3g} m are smaller than three elements "
                f"of {self.spacing:.3g} m; give more points, or larger pores"
            )
        if self.mesh is not None and self.unit is None:
            yield 'the file mesh needs the length of its unit, such as unit = "1 um"'
        uneven = any(n % 4 for n in self.points) or self.layers % 2
        if self.mesh is None and self.second_order and uneven:
            yield (
                f"{self.element} elements span two spacings: points must be multiples of four and "
                f"layers even, got {self.scope} and {self.layers} layers"
            )

    @property
    def second_order(self) -> bool:
        """Whether the elements of a mesh have nodes between their corners."""
        return self.element in ("hex27", "tet10")

    def smaller(self) -> Self:
        """Return the same cell on a coarser grid; a mesh from a file stays as it is."""
        small = super().smaller()
        if self.geometry != "mesh" or self.mesh is not None or not self.second_order:
            return small
        points = tuple(max(4, 4 * round(n / 8)) for n in self.points)
        return self.model_copy(update={"points": points})


class ShearSettings(toml.Settings):
    """Cells of two deformable, elastic bodies with friction, pressed, sheared and released.

    They have the surfaces of the first realisations; the law takes its tangential branch from them.
    """

    friction_coefficient: toml.Number = Field(gt=0.0, le=10.0)
    """Friction coefficient of points of contact."""
    pressures: Annotated[toml.Rising[toml.Pressure], MIDDLE] = Field(min_length=1)
    """Mean pressures of the shear, Pa, rising, from three times the lowest to the highest pressure
    of the cells."""
    realisations: Annotated[toml.Positive, toml.at_most(3)] = 3
    """Number of these cells, at most the number of realisations."""
    points: tuple[Points, Points] | None = None
    """Grid points along x and y, as in [cell] if not given."""
    layers: Annotated[toml.Count, Field(ge=2, le=1000)] | None = None
    """Layers of elements of each body, as in [cell] if not given."""
    steps: Annotated[toml.Count, toml.at_most(6)] = Field(10, ge=3, le=1000)
    """Steps from rest to full slip, at each pressure."""
    cycle: bool = True
    """Whether to add a closed cycle of partial slip, in four more steps at each pressure and
    direction; without it the error of the loss of a joint is unknown."""


class MicroSettings(toml.Settings):
    """The ensemble of cells."""

    realisations: Annotated[toml.Positive, toml.at_most(4)] = Field(description="Number of cells.")
    pressures: toml.Rising[toml.Pressure] = Field(
        min_length=3, description="Mean pressures, Pa, rising."
    )
    seed: toml.Natural = Field(
        0, description="Seed of the first realisation; realisation k has seed + k."
    )
    unload: Annotated[bool, Strict()] | tuple[toml.Pressure, ...] = False
    """Whether to unload through the same pressures; or falling pressures of unloading, Pa."""
    coarser: Annotated[toml.Natural, toml.at_most(0)] = 0
    """Number of the first cells that are also solved on half of their points, pressed and, with
    [micro.shear], sheared, for the error of the grid; each takes an eighth of the time of a
    cell."""
    control: Literal["flat", False] | None = None
    """Whether flat cells on the same and on further surfaces are control variates of the cells,
    which remove most of the sampling error of the law. By default they are used for cells that are
    not flat, on synthetic surfaces with 4 realisations or more, also by a planner; `false` turns
    them off."""
    control_realisations: Annotated[toml.Positive | None, toml.Quick(lambda *_: None)] = None
    """Number of these flat cells. By default the number with the smallest error for the time, from
    the correlation of both kinds of cells; their time is at most about the time of the cells, and
    their number at most 256."""
    spots: bool = False
    """Whether the response contains area and force of every contact spot."""
    leakage: bool = False
    """Whether the law has the hydraulic aperture of the gap along x and y, at every pressure;
    [seal] sets it."""
    shear: ShearSettings = ABSENT

    @field_validator("unload", mode="before")
    @classmethod
    def _check_unload(cls, value: Any) -> Any:
        if not isinstance(value, bool | list | tuple):
            raise ValueError(f"should be true, or a list of pressures that falls, got {value!r}")
        return value

    def _faults(self) -> Iterator[str]:
        down = (self.pressures[-1], *self.unloading)
        if any(late >= early for early, late in pairwise(down)):
            yield (
                f"unload must fall from one pressure to the next, below the largest of pressures, "
                f"{1e-6 * down[0]:g} MPa"
            )
        if self.coarser > self.realisations:
            yield (f"coarser is {self.coarser}, more than the {self.realisations} realisations")
        yield from self._control_faults()
        if self.shear is not None:
            yield from self._shear_faults(self.shear)

    def _control_faults(self) -> Iterator[str]:
        stated = self.control or self.control_realisations
        if stated and self.realisations < FEWEST_PAIRS:
            yield (
                f"control needs {FEWEST_PAIRS} realisations or more, got "
                f"{self.realisations}; give more, or leave control out"
            )
        if self.control_realisations is None:
            return
        if self.control is False:
            yield (
                "control_realisations counts cells that control = false turns off; leave out one "
                "of them"
            )
        if self.control_realisations <= self.realisations:
            yield (
                f"control_realisations is {self.control_realisations}, of which the first "
                f"{self.realisations} have the surfaces of the realisations; give more"
            )

    def _shear_faults(self, shear: ShearSettings) -> Iterator[str]:
        low, high = FEWEST_BELOW * self.pressures[0], self.pressures[-1]
        if shear.pressures[0] < low or shear.pressures[-1] > high:
            yield (
                f"pressures in [micro.shear] should lie from {FEWEST_BELOW:g} times the lowest of "
                f"pressures, {1e-6 * low:g} MPa, to the highest, {1e-6 * high:g} MPa, since "
                f"springs that slip last belong to lower pressures"
            )
        if shear.realisations > self.realisations:
            yield (
                f"realisations in [micro.shear] is {shear.realisations}, more than the "
                f"{self.realisations} cells with these surfaces"
            )

    @property
    def unloading(self) -> tuple[float, ...]:
        """Pressures on the way down, Pa."""
        if isinstance(self.unload, bool):
            return self.pressures[-2::-1] if self.unload else ()
        return self.unload

    @property
    def path(self) -> tuple[float, ...]:
        """All pressures in their order, Pa."""
        return self.pressures + self.unloading


class LawSettings(toml.Settings):
    """The fit of the interface law."""

    terms: toml.Count = Field(40, ge=6, description="Terms of the normal law of surfaces.")
    samples: Annotated[toml.Count, toml.at_most(40)] = Field(200, ge=0)
    """Bootstrap samples for the bands."""
    apart: bool | None = None
    """Whether the tangential stiffnesses along x and y are two numbers; if not given, they are two
    numbers if they differ by more than chance."""
    extrapolate: bool = False
    """Whether answers are given if more than 5 % of a load lies outside the pressures of the cells
    by more than a factor of 2; otherwise they are unknown."""
    roughness: Annotated[toml.Number, Field(ge=0.0, lt=1.0)] | None = None
    """Relative half-width of the 95 % interval of all heights of the surfaces, for the calibration
    by `[[measured]]`; `"20 %"` if not given."""
    discrepancy: Annotated[toml.Number, Field(ge=0.0, lt=1.0)] | None = None
    """Half-width of the 95 % interval of the stiffness of joints about the law of their cells, and
    of its exponent half as much: in the interval of one part, and in the calibration by
    `[[measured]]`; `"10 %"` if not given, 0 for none."""
    friction: Annotated[toml.Number, Field(gt=0.0)] | None = None
    """Friction coefficient of the interface before its calibration by `[[measured]]`, with a
    half-width of 50 %, if the cells are not sheared."""
    stiffness_ratio: Annotated[toml.Number, Field(gt=0.0)] | None = None
    """Tangential over normal stiffness before the calibration, with a half-width of 12 %, if the
    cells are not sheared."""

    @property
    def of_calibration(self) -> list[str]:
        """Keys that are given for the calibration by measured joints."""
        names = ("roughness", "friction", "stiffness_ratio")
        return [name for name in names if getattr(self, name) is not None]


class SealSettings(toml.Settings):
    """A ring that is pressed on a face by the pressures of the cells, against a liquid."""

    diameter: toml.Length = Field(description="Mean diameter of the ring, m.")
    width: toml.Length = Field(description="Width of its contact, over which the liquid leaks, m.")
    viscosity: Viscosity = Field(description="Dynamic viscosity of the liquid, Pa s.")
    pressure_difference: toml.Pressure
    """Pressure difference of the liquid between both sides, Pa."""
    direction: Literal["x", "y"] | None = None
    """Axis of the cells across the ring, along which the liquid leaks; equivalent axes if not
    given."""

    def _faults(self) -> Iterator[str]:
        if self.width >= self.diameter:
            yield (
                f"width is {1e3 * self.width:g} mm, which no ring of a mean diameter of "
                f"{1e3 * self.diameter:g} mm has; correct one of them"
            )

    def leak_rate(self, aperture: np.ndarray) -> np.ndarray:
        """Return the leak rate through an aperture, m, in m3/s: h³ / (12 eta) dp / b pi D (1)."""
        gradient = self.pressure_difference / self.width
        return aperture**3 / (12.0 * self.viscosity) * gradient * np.pi * self.diameter


class SlideSettings(toml.Settings):
    """Body 2 slides over body 1 along x: friction against pressure and distance.

    Both bodies are deformable, at large strain, with the surfaces of the first realisation. The
    resistance beyond the friction of points of contact is ploughing.
    """

    distance: toml.Length = Field(
        description="Length of the slide, m; at most 20 lengths of the cell."
    )
    friction_coefficient: toml.Number = Field(0.0, ge=0.0, le=10.0)
    """Friction coefficient of points of contact."""
    pressures: toml.Rising[toml.Pressure] = ()
    """Mean pressures, Pa, rising; all pressures of the cells if not given."""
    steps: Annotated[toml.Count, toml.at_most(4)] = Field(16, ge=1, le=10_000)
    """Steps of the result over the distance."""

    def within(self, cell: CellSettings, micro: MicroSettings) -> Self:
        """Return a slide of at most a quarter of the cell length, under one pressure."""
        distance = min(self.distance, 0.25 * cell.size[0])
        pressures = MIDDLE.of(self, self.pressures or micro.pressures)
        return self.model_copy(update={"distance": distance, "pressures": pressures})


class AccuracySettings(toml.Settings):
    """Target for the error of an answer; a planner then starts from the other tables."""

    target: Annotated[toml.Number, Field(gt=0.0, le=0.5)] | None = None
    """Largest relative 95 % error of the answer, such as `"2 %"`; the smallest error within `time`
    if not given."""
    of: str | None = None
    """Answer with this error, by its name or in words, such as `"loss"`; the first answer of the
    last stage if not given."""
    quantity: Literal["joint_stiffness", "mean_gap", "contact_fraction", "stiffness"] | None = None
    """Answer with this error as in earlier versions: the first of the joint at every preload, the
    others of the interface at every pressure."""
    at: toml.Pressure | None = None
    """Pressure or preload of the answer, Pa; all pressures if not given."""
    time: toml.Duration | None = None
    """Time limit of the planner, s; it then returns its last answer."""

    def _faults(self) -> Iterator[str]:
        if self.target is None and self.time is None:
            yield "neither target nor time is given; give one of them or both"
        if self.of is not None and self.quantity is not None:
            yield "of and quantity are two names of the answer; leave out quantity"

    @property
    def answer(self) -> str:
        """Name of the answer; empty if none is given."""
        return self.of or self.quantity or ""

    @field_validator("target", mode="before")
    @classmethod
    def _require_percent(cls, value: Any) -> Any:
        if re.fullmatch(r"[1-9]\d*", str(value)):
            raise ValueError(f'{value!r} is not a share; write it as "{value} %"')
        return value


Compliance = Annotated[float, quantity("m/Pa"), Field(ge=0.0), with_unit("m/Pa")]
Zero = Annotated[float, quantity("Pa"), Field(ge=0.0), with_unit("Pa")]
Mass = Annotated[float, quantity("kg/m^2"), Field(gt=0.0), with_unit("kg/m^2")]
Area = Annotated[float, quantity("m^2"), Field(gt=0.0), with_unit("m^2")]


class MeasuredTable(toml.Settings):
    """Measured values of a joint under a uniform pressure, for the calibration of its law.

    Give `[[measured]]` for each table; see [measured joints](interfaces.md#measured-joints).
    """

    file: Path
    """Table with units in its head: `preload, stiffness`; `pressure, closure`;
    `preload, displacement, shear` along loops; or `preload, amplitude, frequency, damping`."""
    kind: Literal["stiffness", "tangential_stiffness", "closure", "loop", "vibration"]
    """Measured values: normal stiffness, tangential stiffness without slip, closure since the first
    row, shear along loops, or tangential vibrations of a mass on the joint."""
    error: toml.Tolerance | None = None
    """Half-width of the 95 % interval of the values, relative to them, or in loops to the largest
    shear; not needed if the table has a column `error`."""
    bodies: Compliance = Field(0.0, description="Compliance of the bodies between the sensors.")
    frame: Compliance | None = None
    """Half-width of the 95 % interval of the compliance of the frame in the values; a fifth of the
    smallest measured compliance if not given."""
    offset: Zero | None = None
    """Half-width of the 95 % interval of the zero of the load; a tenth of the smallest preload if
    not given."""
    area: Area | None = None
    """Nominal area of the joint, which limits its number of cells and sets their scatter; many
    cells if not given."""

    mass: Mass | None = None
    """Vibrating mass over the nominal area, for `kind = "vibration"`."""
    case: Path | None = None
    """Case of bodies with `[vibration]`, in place of `mass`: its first mode is the measured mode,
    and all its interfaces have the law. Amplitudes belong to the node that moves farthest."""

    def _faults(self) -> Iterator[str]:
        if (self.kind == "vibration") != ((self.mass is None) != (self.case is None)):
            yield (
                'either mass or case belongs to kind = "vibration" and is needed there; give both, '
                "or neither"
            )
        if self.case is not None:
            for name in ("area", "bodies", "frame", "offset"):
                if getattr(self, name) != type(self).model_fields[name].default:
                    yield f"{name} does not apply to the structure in case; leave it out"

    def read(self, structure: Structure | None = None) -> MeasuredJoint:
        """Read the table; vibrations of a case with its structure."""
        given = self.model_dump(include={"error", "bodies", "frame", "offset"})
        if self.kind == "vibration":
            return read_vibration(self.file, mass=self.mass, structure=structure, **given)
        return read_measured(self.file, self.kind, **given)

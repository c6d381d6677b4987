"""Tables of interfaces: their law, asperities, loading, and the cut and solver of the bodies."""

from collections.abc import Callable, Collection, Iterator
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from multiscale import macro, upscaling
from multiscale.errors import CaseError
from multiscale.laws import Asperities, AsperityLaw
from multiscale.laws.asperities import class_densities, gaussian_asperities
from multiscale.laws.bulk.bulk_law import mindlin_ratio
from multiscale.macro import substructures
from multiscale.pipeline.tables import toml_model as toml
from multiscale.pipeline.tables.grain_settings import SlidingSpeed
from multiscale.schema import Dataset, with_cautions
from multiscale.upscaling.branches import state_shear, take_sliding_friction
from multiscale.upscaling.fit import branch_origins
from multiscale.upscaling.reading import TABLE
from multiscale.upscaling.tables import with_stated_error

if TYPE_CHECKING:
    from multiscale.macro.substructures import ProcessGroup

PerArea = Annotated[
    float, toml.quantity("1/m^2", uncertain=True), Field(gt=0.0), toml.with_unit("1/m^2")
]
Height = Annotated[float, toml.quantity("m"), toml.with_unit("m")]


class StatedAsperities(toml.Settings):
    """Statistics of the asperities between two equal bodies, from published surfaces.

    Values may have the half-width of a 95 % interval, such as `"1.4 mm +- 10 %"`.
    """

    density: PerArea = Field(description="Asperities per area, 1/m².")
    radius: toml.UncertainLength = Field(description="Composite radius of both surfaces, m.")
    rms_height: toml.UncertainLength | None = None
    """Root mean square of Gaussian heights about their mean plane, m."""
    heights: toml.Rising[Height] = ()
    """Rising heights of asperities above the plane of zero gap, m, in place of `rms_height`;
    contact begins at the highest."""
    weights: tuple[toml.Factor, ...] = ()
    """Probability density at each entry of `heights`, in any unit."""
    height_factor: toml.UncertainFactor = 1.0
    """Factor of all heights, with the half-width of the roughness."""
    youngs_modulus: toml.UncertainPressure = Field(
        description="Young's modulus of both bodies, Pa."
    )
    poissons_ratio: toml.Ratio = Field(description="Poisson's ratio of both bodies.")
    yield_stress: toml.UncertainPressure | None = None
    """Yield stress, Pa; the asperities are elastic if not given."""
    tangent_modulus: Annotated[
        toml.Number, toml.quantity("Pa"), Field(ge=0.0), toml.with_unit("Pa")
    ] = 0.0
    """Slope of the stress over the strain after yield, Pa."""

    def _faults(self) -> Iterator[str]:
        if (self.rms_height is None) == (not self.heights):
            yield "asperities take either rms_height or heights with their weights"
        if len(self.heights) != len(self.weights):
            yield (
                f"asperities take a weight for each height, got {len(self.heights)} heights and "
                f"{len(self.weights)} weights"
            )

    def build(self, friction: float, stiffness_ratio: float | None, damage: float) -> AsperityLaw:
        """Return the law of an interface; damage reduces the number of asperities."""
        density = (1.0 - damage) * self.density
        height, densities = (
            class_densities(np.array(self.heights), np.array(self.weights), density)
            if self.rms_height is None
            else gaussian_asperities(self.rms_height, density)
        )
        asperities = Asperities(
            self.height_factor * height,
            densities,
            self.radius,
            self.youngs_modulus,
            self.poissons_ratio,
            self.yield_stress or np.inf,
            self.tangent_modulus,
        )
        return AsperityLaw(asperities, friction, stiffness_ratio)


SLABS, FEW_SLABS = 48, 8
"""Slabs of the law of a joint under cycles, whose loss is a small difference, and of a joint that
is only pressed: errors of the shear up to .5 and 8 % of the friction limit; see
:class:`Sliders`."""

Slabs = Annotated[toml.Count, Field(ge=8, le=10_000)]

OpenLaw = Callable[[Path, bool], Dataset]
"""Maps a file, and whether a case is run quick, to an interface law, or to a volume."""

Damage = Annotated[toml.Number, Field(ge=0.0, lt=1.0)]


UNKNOWN_ERROR = (
    "the error of a table is unknown, and in no interval; give it by law_error, such as "
    'law_error = "10 %"'
)

LawError = Annotated[toml.Number, Field(gt=0.0, lt=1.0)]


FEW_PARTS = toml.Quick(lambda _, parts: tuple(min(2, number) for number in parts))
RUN_QUICK = toml.Quick(lambda table, _: table.law is not None)
"""Keys of quick cases: substructures along an axis, and whether the case of a law is run quick."""


class Substructures(toml.Settings):
    """The cut, and the solver of the substructures; see :func:`multiscale.macro.solve_latin`."""

    parts: Annotated[tuple[toml.Positive, toml.Positive], FEW_PARTS] = (1, 1)
    """Substructures along x and y, of every body."""
    coarse: bool = True
    """Whether a coarse problem balances interface resultants."""
    model: Literal["resolved", "homogenised", "adaptive"] = "resolved"
    """Substructures of links: `"resolved"` with all their nodes; `"homogenised"` by their stiffness
    for motions of corners and edges, as long as no link slackens; or `"adaptive"`, which resolves
    the substructures with slack links. If links of a homogenised `tensegrity_grid` slacken, at
    rest, every substructure follows the law of its modules, with intervals from a specimen of fewer
    modules. This needs at least 4 substructures along each axis, with 4 to 8 modules along each
    axis; see the manual `homogenised.md`."""
    tolerance: toml.Tolerance = Field(1e-8, description="Relative residual of a solved step.")
    max_iterations: toml.Positive = Field(
        400, description="Largest number of iterations of a step."
    )
    homogenise: bool = False
    """Whether to write the stiffness of substructures against their interface resultants, before
    and after slackening, to `NAME-homogenised.nc`; see `multiscale.macro.homogenise`."""

    @property
    def count(self) -> int:
        """Substructures of a body, or of a grid."""
        return self.parts[0] * self.parts[1]

    def stop(self, team: "ProcessGroup | None") -> dict[str, Any]:
        """Return the stopping criteria of the solver, and the processes that share it."""
        return {"tolerance": self.tolerance, "max_iterations": self.max_iterations, "team": team}

    def method(self, team: "ProcessGroup | None") -> "macro.LatinMethod":
        """Return the solver of elastic bodies."""
        return macro.LatinMethod(self.parts, coarse=self.coarse, **self.stop(team))


class SolverChoice(toml.Settings):
    """The solver of the bodies of a case."""

    method: Literal["newton", "multigrid", "latin"] | None = None
    """Solver of the bodies: Newton's method on the whole structure, with a direct solver
    (`"newton"`) or for large bodies with multigrid (`"multigrid"`), or `"latin"` on substructures
    of `[substructures]`; if not given, the fastest method."""


class LawSource(toml.Settings):
    """The law of the interface between blocks, if the case has no cells."""

    law: Path | None = None
    """Law: dataset of a run or fit; folder of a run; case, by its file or the name of a shipped
    case, which is run in a separate folder; or table of `pressure` and `overclosure` in a `.csv`
    file. Not needed with cells, or if the command names a file."""
    law_error: LawError | None = None
    """Relative half-width of the 95 % interval of overclosure and stiffness of a table, such as
    `"10 %"`; the error is unknown if not given."""
    quick: Annotated[bool, RUN_QUICK] = False
    """Whether a case that `law` names is run `--quick`."""
    way: Literal["sequential", "adaptive", "concurrent", "direct"] = "sequential"
    """Pressures of the cells for the structure. `"sequential"`: the pressures of their case.
    `"adaptive"`: further pressures if more than 1 % of the load of an interface is outside these
    pressures, or between pressures at which the form of the law has the largest error.
    `"concurrent"`: pressures within 20 % of the pressure of every point of an interface.
    `"direct"`: cells as wide as the blocks, with all of their roughness. All points share the
    cells. The law of a command is used unchanged."""
    speed: SlidingSpeed | None = None
    """Speed of sliding of a law of grains, m/s; see `[third_body]`."""
    extrapolate: bool = False
    """Whether answers are given if more than 5 % of the load of an interface lies outside the
    pressures of the law by more than a factor of 2; otherwise they are unknown."""

    @property
    def source(self) -> Path:
        """File or case of the law."""
        if self.law is None:
            raise CaseError(
                "the structure has joints but no law: name a case or a file by [interface] law, or "
                "a file by --law, such as the interface_law.nc of a run"
            )
        return self.law

    def read(self, open_law: OpenLaw) -> Dataset:
        """Read the normal law, with the error stated in the case, or a caution for a table."""
        law = upscaling.at_speed(open_law(self.source, self.quick), self.speed)
        if self.law_error is not None:
            return with_stated_error(law, self.law_error)
        return with_cautions(law, UNKNOWN_ERROR) if law.attrs.get("family") == TABLE else law


class JointLaw(LawSource):
    """The law of the interfaces between user bodies: a normal law with friction."""

    friction: toml.UncertainFactor | None = None
    """Friction coefficient of Coulomb's law; if not given, it comes from sheared cells or else from
    a sliding cell at the last preload."""
    stiffness_ratio: Annotated[toml.UncertainNumber, Field(gt=0.0)] | None = None
    """Tangential over normal stiffness of springs that slip one after the other; if not given, the
    ratio of the law, or else 2 (1 - nu)/(2 - nu), with a caution."""

    @property
    def given(self) -> dict[str, Any]:
        """Parameters of the sliders that the case gives, by their names."""
        values = {"friction": self.friction, "stiffness_ratio": self.stiffness_ratio}
        return {name: value for name, value in values.items() if value is not None}

    def missing(
        self, measured: Collection[str], strict: bool, where: str = "[interface]"
    ) -> Iterator[str]:
        """Report a value of the joints that neither the case nor the law has."""
        if self.friction is None and "friction" not in measured:
            yield (
                f"{where} has no friction, and neither has the law of the joints: shear the "
                f"cells by [micro.shear], slide them over their length or more by [slide], or give "
                f"friction"
            )
        if strict and self.stiffness_ratio is None and "stiffness_ratio" not in measured:
            yield (
                f"{where} has no stiffness_ratio, and neither has the law of the joints, and "
                f"strict = true assumes nothing: shear the cells by [micro.shear], or give "
                f"stiffness_ratio"
            )

    def complete(
        self,
        law: Dataset,
        poissons_ratio: float,
        pressure: float,
        strict: bool,
        where: str = "[interface]",
    ) -> Dataset:
        """Return the law with a tangential branch: stated, else measured, else from theory."""
        measured = upscaling.tangential_values(law)
        if strict and branch_origins(law).get("shear", "").startswith("assumed"):
            measured = {}
        if self.friction is None and "friction" not in measured and "sliding_friction" in law:
            law = take_sliding_friction(law, pressure)
            measured = upscaling.tangential_values(law)
        for fault in self.missing(measured, strict, where):
            raise CaseError(fault)
        if self.stiffness_ratio is None and "stiffness_ratio" not in measured:
            if coated := law.attrs.get("coatings"):
                raise CaseError(
                    f"the law of the joints has no stiffness_ratio, and theory has no ratio for "
                    f"the coatings of {coated}; shear the cells by [micro.shear], or give "
                    f"stiffness_ratio in {where}"
                )
            if "sliding_speed" in law.attrs:
                raise CaseError(
                    f"the law of grains has no stiffness_ratio, and theory has none for rigid "
                    f"grains; give stiffness_ratio in {where}"
                )
            law = upscaling.assume_shear(law, stiffness_ratio=mindlin_ratio(poissons_ratio))
        law = state_shear(law, friction=self.friction, stiffness_ratio=self.stiffness_ratio)
        return with_cautions(law, *_lay_caution(law))


class RoughInterface(JointLaw):
    """The law of the interfaces of stacked blocks and lap joints: a normal law with friction."""

    damage: tuple[Damage, ...] = ()
    """Damage D of interfaces, from the lowest; each law has the factor 1 - D. 0 if not given."""


def _lay_caution(law: Dataset) -> list[str]:
    """Report the mean ratio of a law with different stiffness ratios along x and y."""
    x, y = law["shear_stiffness_ratio"].to_numpy()
    if not np.isfinite(x + y) or np.isclose(x, y, rtol=1e-9):
        return []
    return [
        f"the tangential stiffness ratio is {x:.3g} along x and {y:.3g} along y, and the joints "
        f"take the mean of both, {0.5 * (x + y):.3g}, in all directions"
    ]


class Preloads(toml.Settings):
    """Pressures on the pressed face of stacked blocks and lap joints."""

    preloads: tuple[toml.Pressure, ...] = Field(min_length=1)
    """Pressures on the pressed face, Pa; the last pressure stays constant."""

    @property
    def even(self) -> list[tuple[float, float]]:
        """Least and largest pressure of an interface of the size of the pressed face, Pa."""
        return [(preload, preload) for preload in self.preloads]


class JointPreloads(SolverChoice, Preloads):
    """Pressures on the pressed face of bodies that are solved numerically."""


class LoadFactors(SolverChoice):
    """Factors of the load of a plate."""

    load_factors: tuple[toml.Number, ...] = Field(min_length=1)
    """Load of every step over the whole load."""


class RisingPreloads(Preloads):
    """Uniform pressures between blocks."""

    preloads: toml.Rising[toml.Pressure] = Field(min_length=1)
    """Nominal pressures, Pa, rising; best within the data of the law."""


class Cycles(toml.Settings):
    """Cycles of shear after preloads; see :func:`multiscale.macro.substructures.joint_path`."""

    shear: toml.Pressure = Field(description="Amplitude of the shear on the sheared face, Pa.")
    amplitudes: Annotated[
        tuple[toml.Pressure, ...], toml.Quick(lambda _, smaller: smaller[:1])
    ] = ()
    """Smaller amplitudes, Pa, rising: secant stiffness and loss of a closed cycle are computed at
    these and at `shear`, at every preload."""
    cycles: Annotated[toml.Positive, toml.at_most(1)]
    """Closed cycles after the first loading."""
    steps: Annotated[toml.Positive, toml.at_most(2)] = 10
    """Load steps from zero to the amplitude."""
    slabs: Slabs = SLABS
    """Slabs of the beds of sliders."""

    def _faults(self) -> Iterator[str]:
        if any(low >= high for low, high in pairwise(self.all_amplitudes)):
            listed = ", ".join(f"{1e-6 * amplitude:g}" for amplitude in self.amplitudes)
            yield (
                f"amplitudes ({listed} MPa) should rise and stay below shear "
                f"({1e-6 * self.shear:g} MPa), which is always solved"
            )

    @property
    def all_amplitudes(self) -> tuple[float, ...]:
        """Amplitudes of the cycles at every preload, Pa."""
        return (*self.amplitudes, self.shear)

    def path(self, preloads: tuple[float, ...]) -> "substructures.LoadPath":
        """Return the preloads, the cycles at the last of them, and the cycles at all."""
        return substructures.joint_path(
            preloads, self.shear, self.cycles, self.steps, self.all_amplitudes
        )

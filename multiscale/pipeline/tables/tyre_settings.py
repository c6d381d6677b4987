"""Tables of a case of rubber that slides on a road."""

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from multiscale.laws import wlf_shift
from multiscale.micro.elastic.viscoelastic import RelaxingSolid
from multiscale.pipeline.tables import toml_model as toml
from multiscale.pipeline.tables.case_tables import doubt_scatter
from multiscale.pipeline.tables.structure_kind import Pressed, far_loads

if TYPE_CHECKING:
    from multiscale.pipeline.tables.settings import Case

FASTEST = 100.0  # m/s; faster rubber heats unevenly
QUICK_SAMPLES = 80  # bootstrap samples of a quick friction law, at most

TABLES = ("rubber", "road", "cell", "sliding", "tread")
"""Tables of rubber on a road; a case has all of them, and ``[law]``."""

KEYS = {"cell": ("size", "points"), "law": ("samples", "extrapolate")}
"""Keys of tables of joints that are also for rubber on a road."""

COARSE = toml.Quick(lambda *_: (6, 4, 2))  # elements of the tread of a quick case

Temperature = Annotated[float, toml.quantity("K"), Field(gt=0.0), toml.with_unit("K")]
Speed = Annotated[float, toml.quantity("m/s"), Field(gt=0.0, le=FASTEST), toml.with_unit("m/s")]


class Rubber(toml.Settings):
    """A linear viscoelastic solid; see :class:`multiscale.micro.RelaxingSolid`."""

    relaxed_modulus: toml.Pressure = Field(description="Young's modulus after a long time, Pa.")
    poissons_ratio: toml.Ratio = Field(0.49, description="Poisson's ratio at all times.")
    moduli: tuple[toml.Pressure, ...] = Field(
        (), description="Young's moduli of the Prony series, Pa."
    )
    times: tuple[toml.Duration, ...] = ()
    """Relaxation times, s, of the moduli."""
    reference_temperature: Temperature
    """Temperature of the times, K, as `"20 degC"`."""
    wlf_c1: toml.Number = Field(gt=0.0, description="First constant of Williams, Landel and Ferry.")
    wlf_c2: Temperature = Field(description="Second constant, K; see `multiscale.laws.wlf_shift`.")

    def _faults(self) -> Iterator[str]:
        if not self.moduli:
            yield (
                "moduli has no relaxing part: rubber that slides without viscosity has no "
                "friction by hysteresis; give moduli and times"
            )
        if len(self.moduli) != len(self.times):
            yield (
                f"give as many times as moduli, got {len(self.times)} times and "
                f"{len(self.moduli)} moduli"
            )

    @property
    def solid(self) -> RelaxingSolid:
        """The solid at the reference temperature."""
        return RelaxingSolid(self.relaxed_modulus, self.poissons_ratio, self.moduli, self.times)

    def shift(self, temperature: float) -> float:
        """Factor of all relaxation times at a temperature, K."""
        return wlf_shift(temperature, self.reference_temperature, self.wlf_c1, self.wlf_c2)


class Slides(toml.Settings):
    """The ensemble of cells: each slides at every pressure, speed and temperature."""

    realisations: Annotated[toml.Positive, toml.at_most(4)] = Field(description="Number of cells.")
    pressures: toml.Rising[toml.Pressure] = Field(
        min_length=3, description="Mean pressures, Pa, rising."
    )
    speeds: toml.Rising[Speed] = Field(min_length=4, description="Sliding speeds, m/s, rising.")
    temperatures: toml.Rising[Temperature] = Field(min_length=3)
    """Temperatures, K, rising; such as `"20 degC"`."""
    seed: toml.Natural = Field(
        0, description="Seed of the first realisation; realisation k has seed + k."
    )


class Tread(toml.Settings):
    """The tread block; see :class:`multiscale.macro.joint.TreadBlock`."""

    length: toml.Length = Field(description="Length along the motion, m.")
    width: toml.Length = Field(description="Width across the motion, m.")
    height: toml.Length = Field(description="Height from the road to the carcass, m.")
    pressure: toml.Pressure = Field(description="Nominal pressure on the road, Pa.")
    elements: Annotated[tuple[Annotated[toml.Count, Field(ge=1, le=40)], ...], COARSE] = Field(
        (8, 5, 2), min_length=3, max_length=3
    )
    """Elements along the motion, across and upwards."""


def rubber_faults(case: "Case") -> Iterator[str]:
    """Report missing tables of rubber on a road, and tables and keys of joints."""
    if missing := [name for name in TABLES if getattr(case, name) is None]:
        yield (
            f"rubber on a road takes {toml.list_tables(TABLES)}, and there is no "
            f"{toml.list_tables(missing)}"
        )
    stray = [
        name for name, value in case if value and name not in ("title", "law", "accuracy", *TABLES)
    ]
    if stray:
        yield f"{stray[0]} is not for rubber on a road; leave it out"
    for name, keys in KEYS.items():
        table = getattr(case, name)
        defaults = {key: field.default for key, field in type(table).model_fields.items()}
        strange = [key for key, value in table if key not in keys and value != defaults[key]]
        if strange:
            yield (
                f"{strange[0]} in [{name}] is not for rubber on a road, whose [{name}] "
                f"has only {' and '.join(keys)}; leave it out"
            )
    rubber, slides = case.rubber, case.sliding
    coldest = rubber.reference_temperature - rubber.wlf_c2
    if slides.temperatures[0] <= coldest:
        yield (
            f"temperatures in [sliding] begin at {slides.temperatures[0]:g} K, where the shift of "
            f"[rubber] is not defined; stay above {coldest:g} K"
        )
    if not case.extrapolate:
        even = (case.tread.pressure, case.tread.pressure)
        yield from far_loads(
            Pressed("pressure in [tread] presses the road", [even]),
            (slides.pressures[0], slides.pressures[-1]),
            "pressures in [sliding]",
            "give such pressures in [sliding], or set extrapolate = true in [law]",
        )


def doubt_road(case: "Case") -> Iterator[str]:
    """Yield cautions about the friction law, a sentence each."""
    yield from case.cell.caution_wavelength(case.road.short_cutoff, "the road", "its contact needs")
    yield from doubt_scatter(case.sliding.realisations)
    wide = [speed for speed, late in pairwise(case.sliding.speeds) if late > 31.0 * speed]
    if wide:
        yield f"the speeds leave more than 1.5 decades open above {wide[0]:g} m/s"

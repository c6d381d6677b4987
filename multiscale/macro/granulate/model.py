"""Model of a granulate: contact law, loads, parameters of the solver, and needs."""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.macro.granulate.bodies import CYLINDER, PLANE, Grains, Wall
from multiscale.needs import Needs, choose

PARALLEL = 1e-12  # of 1 plus the cosine of two normals, below which planes face each other

PER_GRAIN, PER_UNKNOWN, PER_FRAME = 900, 350, 150
"""Peak memory of a dense pile, byte: per grain, per grain and unknown of a contact, and per grain
and frame."""


@dataclass(frozen=True)
class ContactLaw:
    r"""Contact law of grains: Coulomb friction, restitution and compliance.

    Parameters
    ----------
    friction : float, Coulomb's coefficient, dimensionless
    restitution : float
        Newton's coefficient, from 0 to 1. Pairs that approach slowly do not bounce below 1.
    compliance : float
        :math:`a` of (1), dimensionless; zero for a rigid contact.
    relaxation : float, number of steps in which an overlap is removed, at least 1
    tangential_compliance : float
        :math:`a` of (1) across the normal, dimensionless, at least ``compliance``: with a rigid
        normal direction 0.05 or more makes dense piles with friction solvable.

    Raises
    ------
    CaseError
        If a parameter is outside its range.

    Notes
    -----
    A compliant contact of mass :math:`m` moves while its impulse :math:`r` differs from the impulse
    :math:`r^-` of the last step, along the normal and across it:

    .. math:: u + b + \frac{a}{m} (r - r^-) = 0 \quad \text{instead of} \quad u + b = 0.    \tag{1}

    In a step of length h it is a spring of stiffness :math:`m / (a h^2)` with an overlap that
    relaxes to zero at rest. It regularises the contact problem, which then needs far fewer sweeps,
    with a = 0.02 a fourth or less. If grains would overlap by more than 0.8 % of a radius, the
    contact is stiffened for this step. A contact that bounces has its restitution: it is rigid
    along its normal, and only ``tangential_compliance`` acts across it. The energy stored in an
    overlap is released when the grains separate.

    A tangential compliance leaves the normal direction rigid. Contacts that stick creep while their
    tangential impulse changes, by a share of the closing velocity of the size of a, and stay where
    they are at rest; Coulomb's bound is exact.

    Pairs that meet faster than gravity accelerates them in two steps bounce in turn, each with
    Newton's coefficient; with a restitution of 1 all pairs do. Such impacts never gain energy.
    """

    friction: float = 0.5
    restitution: float = 0.0
    compliance: float = 0.0
    relaxation: float = 10.0 / 3.0
    tangential_compliance: float = 0.0

    def __post_init__(self) -> None:
        require("restitution", self.restitution, "[0, 1]")
        require("relaxation", self.relaxation, "[1, inf]")
        for name in ("friction", "compliance", "tangential_compliance"):
            require(name, getattr(self, name), "[0, inf)")


@dataclass(frozen=True)
class Solver:
    """Parameters of the solver of contacts.

    Parameters
    ----------
    tolerance : float
        Bound on the natural-map error relative to the closing velocities without impulses;
        dimensionless.
    max_iterations : int, limit of sweeps in a step
    most_assembled : int
        Largest number of contacts for which :func:`multiscale.nonsmooth.solve_friction` solves a
        step on which the sweeps fail; interior points solve more contacts without friction. With
        zero sweeps are all there is.

    Raises
    ------
    CaseError
        If a parameter is outside its range.
    """

    tolerance: float = 1e-4
    max_iterations: int = 1000
    most_assembled: int = 400

    def __post_init__(self) -> None:
        require("tolerance", self.tolerance, "(0, 1)")
        require("max_iterations", self.max_iterations, "[1, inf)", integer=True)
        require("most_assembled", self.most_assembled, "[0, inf)", integer=True)


@dataclass(frozen=True)
class Model:
    """Grains and walls with their loads.

    Parameters
    ----------
    gravity : array_like, shape (3,), acceleration of gravity, m/s2
    period : array_like, shape (3,)
        Period of space along each axis, m; infinite along axes without a period.
    damping_rate : float
        Rate of decay of the velocities of grains, 1/s; infinite for quasi-static motion, in which a
        step starts without velocity.
    pressure : float, optional
        Pressure on a periodic cell without walls, which strains equally along its free axes, Pa;
        the size of the cell is fixed if it is not given.
    strain_rate : tuple of float or None, shape (3,)
        Prescribed rates of the logarithmic strain of such a cell along its axes, 1/s, extension
        positive; ``None`` along axes that strain under the pressure.

    Raises
    ------
    CaseError
        If the damping is negative, a period is not positive, a strain rate is not finite, planes
        cross, or pressure, strain rate, period and walls contradict.
    """

    grains: Grains
    walls: tuple[Wall, ...] = ()
    law: ContactLaw = ContactLaw()
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    period: tuple[float, float, float] = (np.inf, np.inf, np.inf)
    damping_rate: float = 0.0
    pressure: float | None = None
    strain_rate: tuple[float | None, float | None, float | None] = (None, None, None)

    def __post_init__(self) -> None:
        require("damping_rate", self.damping_rate, "[0, inf]", "1/s")
        for axis, length, rate in zip("xyz", self.period, self.strain_rate, strict=True):
            require(f"period along {axis}", length, "(0, inf]", "m")
            if rate is not None:
                require(f"strain rate along {axis}", rate, "(-inf, inf)", "1/s")
        self._refuse_crossing_planes()
        if self.pressure is None:
            if self.driven:
                raise CaseError("a strain rate needs a pressure along the other axes, got none")
            return
        needed = [0, 2] if self.grains.planar else [0, 1, 2]
        if not np.all(self.strained[needed]) or self.walls:
            raise CaseError("a pressure acts on a cell that is periodic in space and has no walls")
        require("pressure", self.pressure, "(-inf, inf)", "Pa")

    def _refuse_crossing_planes(self) -> None:
        """Refuse parallel planes that face each other without space between them."""
        planes = [(k, wall) for k, wall in enumerate(self.walls) if wall.bore == 0.0]
        for (i, wall), (j, other) in combinations(planes, 2):
            distance = float(wall.unit @ np.subtract(other.point, wall.point))
            if wall.unit @ other.unit < PARALLEL - 1.0 and not distance > 0.0:
                raise CaseError(
                    f"walls {i} and {j} cross: the space between them is {distance:g} m wide; move "
                    f"them apart or turn their normals to the grains"
                )

    @property
    def strained(self) -> np.ndarray:
        """Axes with a finite period, shape (3,), bool."""
        return np.array([bool(np.isfinite(length)) for length in self.period])

    @cached_property
    def free(self) -> np.ndarray:
        """Axes along which the cell strains under its pressure, shape (3,), bool."""
        prescribed = np.array([rate is not None for rate in self.strain_rate])
        return self.strained & ~prescribed if self.pressure is not None else np.zeros(3, bool)

    @property
    def driven(self) -> bool:
        """Whether a strain rate of the cell is prescribed."""
        return any(rate is not None for rate in self.strain_rate)

    @cached_property
    def prescribed_rate(self) -> np.ndarray:
        """Prescribed strain rates, zero along the other axes, shape (3,), 1/s."""
        return np.array([rate or 0.0 for rate in self.strain_rate])

    def volume(self, period: np.ndarray) -> float:
        """Volume of the cell, m3."""
        return float(np.prod(period[np.isfinite(period)])) * (self.grains.thickness or 1.0)

    @cached_property
    def frictional(self) -> bool:
        """Whether contacts have friction, with three unknowns instead of one unknown."""
        return max([self.law.friction, *(wall.friction or 0.0 for wall in self.walls)]) > 0.0

    @cached_property
    def turns(self) -> bool:
        """Whether grains rotate, by friction or from the start."""
        return self.frictional or bool(np.any(self.grains.spin))

    @cached_property
    def friction(self) -> np.ndarray:
        """Coefficients of grains and of each wall, shape (1 + walls,); empty without friction."""
        if not self.frictional:
            return np.empty(0)
        grains = self.law.friction
        walls = [grains if wall.friction is None else wall.friction for wall in self.walls]
        return np.array([grains, *walls])

    @cached_property
    def mobility(self) -> np.ndarray:
        """Mobilities as in :class:`~multiscale.macro.granulate.contacts.Velocities`, 1/kg."""
        grains, turns = self.grains, self.turns
        mobility = np.zeros((grains.n + len(self.walls), 3 if turns else 1))
        mobility[: grains.n, :2] = 1.0 / grains.mass[:, None]
        if turns:
            mobility[: grains.n, 2] = grains.radius**2 / grains.inertia
        mobility[grains.n :, 0] = [wall.mobility for wall in self.walls]
        return mobility

    @cached_property
    def masses(self) -> np.ndarray:
        """Mass of each component of the velocities, kg; zero for fixed and moved walls."""
        masses, mobility = np.zeros_like(self.free_acceleration), self.mobility
        moves = mobility[:, 0] > 0.0
        masses[moves, :3] = 1.0 / mobility[moves, :1]
        if self.turns:
            turns = mobility[:, 2] > 0.0
            masses[turns, 4:7] = 1.0 / mobility[turns, 2:]
        return masses

    @cached_property
    def shapes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Kind (walls,), direction (walls, 3) and radius (walls,), m, of the walls."""
        axis = np.array([wall.unit for wall in self.walls]).reshape(-1, 3)
        bore = np.array([wall.bore for wall in self.walls], float)
        return np.where(bore > 0.0, CYLINDER, PLANE), axis, bore

    @cached_property
    def free_acceleration(self) -> np.ndarray:
        """Acceleration without contacts of each component of the velocities, m/s2."""
        acceleration = np.zeros((self.mobility.shape[0], 8 if self.turns else 4))
        acceleration[: self.grains.n, :3] = self.gravity
        for w, wall in enumerate(self.walls, self.grains.n):
            acceleration[w, :3] = wall.acceleration
        return acceleration


def grain_needs(
    grains: int,
    frames: int,
    law: ContactLaw,
    solver: Solver,
    *,
    wall_friction: float = 0.0,
    strained: bool = False,
) -> Needs:
    """Return the unknowns, operators and memory of a simulation of grains."""
    friction = max(law.friction, wall_friction) > 0.0
    choices = (
        ("sweeps", True, "over the contacts in turn", ""),
        ("friction", friction, "Coulomb's limit at each contact", "no friction is given"),
        ("rotation", friction, "spins and moments of inertia", "no friction rotates the grains"),
        ("cell strain", strained, "rates along the axes, branches", "no cell strains"),
        (
            "springs",
            max(law.compliance, law.tangential_compliance) > 0.0,
            "of compliant contacts",
            "contacts are rigid",
        ),
        ("restitution", law.restitution > 0.0, "of pairs that meet fast", "no pair bounces"),
        (
            "assembled problem",
            solver.most_assembled > 0 and not strained,
            f"all contacts at once, where sweeps fail on at most {solver.most_assembled} of them",
            "only sweeps",
        ),
    )
    spin = ("spin",) if friction else ()
    unknowns = 3 if friction else 1
    return Needs(
        unknowns_per_contact=unknowns,
        kinematics="rigid grains in motion, impulses in place of forces",
        choices=tuple(choose(*choice) for choice in choices),
        state_variables=("position", "velocity", *spin, "impulse of each contact"),
        fields=("position", "velocity", *spin, "contact force"),
        libraries=("numba",),
        memory=grains * (PER_GRAIN + PER_UNKNOWN * unknowns + PER_FRAME * frames),
    )

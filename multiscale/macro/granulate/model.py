"""Parameters of a granulate: contact law, loads and contact solver; its unknowns and memory."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.granulate.grain_bodies import CYLINDER, PLANE, Grains, Wall
from multiscale.needs import Needs, choose

__all__ = ["ContactLaw", "Model", "Solver", "grain_needs"]

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
        Newton's coefficient, from 0 to 1. Pairs that approach slowly do not bounce.
    compliance : float
        :math:`a` of (1), dimensionless; zero for a rigid contact.
    relaxation : float, number of steps in which an overlap is removed, at least 1

    Raises
    ------
    CaseError
        If a parameter is outside its range.

    Notes
    -----
    A compliant contact of mass :math:`m` moves while its impulse :math:`r` differs from the impulse
    :math:`r^-` of the last step, along the normal and across it:

    .. math:: u + b + \frac{a}{m} (r - r^-) = 0 \quad \text{instead of} \quad u + b = 0.    \tag{1}

    It is a spring of stiffness :math:`m / (a h^2)` in a step of length h whose overlap relaxes to
    zero at rest. It regularises the contact problem, which then takes far fewer sweeps, with
    a = 0.02 a fourth or less. If grains would overlap by more than 0.8 % of a radius, the contact
    is stiffened for this step; a contact that bounces is rigid and keeps its restitution. The
    energy stored in an overlap is released when the grains separate.
    """

    friction: float = 0.5
    restitution: float = 0.0
    compliance: float = 0.0
    relaxation: float = 10.0 / 3.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.friction < np.inf:
            raise CaseError(f"friction must be finite and not negative, got {self.friction:g}")
        if not 0.0 <= self.restitution <= 1.0:
            raise CaseError(f"restitution must lie between 0 and 1, got {self.restitution:g}")
        if not 0.0 <= self.compliance < np.inf:
            raise CaseError(f"compliance must be finite and not negative, got {self.compliance:g}")
        if not self.relaxation >= 1.0:
            raise CaseError(f"relaxation must be at least one step, got {self.relaxation:g}")


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
        step on which the sweeps fail.

    Raises
    ------
    CaseError
        If a parameter is outside its range.
    """

    tolerance: float = 1e-4
    max_iterations: int = 1000
    most_assembled: int = 400

    def __post_init__(self) -> None:
        if not 0.0 < self.tolerance < 1.0:
            raise CaseError(f"tolerance must lie between 0 and 1, got {self.tolerance:g}")
        if self.max_iterations < 1:
            raise CaseError(f"max_iterations must be at least 1, got {self.max_iterations}")


@dataclass(frozen=True)
class Model:
    """Grains and walls with their loads.

    Parameters
    ----------
    grains : Grains
    walls : tuple of Wall
    law : ContactLaw
    gravity : array_like, shape (3,), acceleration of gravity, m/s2
    period : array_like, shape (3,)
        Period of space along each axis, m; infinite along axes without a period.
    damping_rate : float
        Rate at which grains lose velocity, 1/s; infinite for quasi-static motion, in which a step
        starts without velocity.
    pressure : float, optional
        Pressure on a periodic cell without walls, which strains equally along its free axes, Pa;
        the size of the cell is fixed if it is not given.
    strain_rate : tuple of float or None, shape (3,)
        Prescribed rates of the logarithmic strain of such a cell along its axes, 1/s, extension
        positive; ``None`` along axes that strain under the pressure.

    Raises
    ------
    CaseError
        If the damping is negative, or pressure, strain rate, period and walls contradict.
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
        if not self.damping_rate >= 0.0:
            raise CaseError(f"damping_rate must not be negative (1/s), got {self.damping_rate:g}")
        if self.pressure is None:
            if self.driven:
                raise CaseError("a strain rate needs a pressure along the other axes, got none")
            return
        needed = [0, 2] if self.grains.planar else [0, 1, 2]
        if not np.all(self.strained[needed]) or self.walls:
            raise CaseError("a pressure acts on a cell that is periodic in space and has no walls")
        if not np.isfinite(self.pressure):
            raise CaseError(f"pressure must be finite (Pa), got {self.pressure:g}")

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
        """Whether a contact has friction, and three unknowns in place of one."""
        return max([self.law.friction, *(wall.friction or 0.0 for wall in self.walls)]) > 0.0

    @cached_property
    def turns(self) -> bool:
        """Whether grains spin: something turns them, or they spin at the start."""
        return self.frictional or bool(np.any(self.grains.spin))

    @cached_property
    def friction(self) -> np.ndarray:
        """Coefficients of grains and of each wall, shape (1 + walls,); empty without friction."""
        if not self.frictional:
            return np.empty(0)
        own = self.law.friction
        return np.array([own, *(own if w.friction is None else w.friction for w in self.walls)])

    @cached_property
    def mobility(self) -> np.ndarray:
        """Mobilities as in :class:`~multiscale.macro.granulate.contact_solver.Velocities`, 1/kg."""
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
    """Return the unknowns, operators and memory of a simulation of grains.

    Examples
    --------
    >>> from multiscale.macro.granulate import ContactLaw, Solver
    >>> needs = grain_needs(1000, 11, ContactLaw(friction=0.5), Solver())
    >>> needs.unknowns_per_contact, "springs" in needs.built
    (3, False)
    >>> grain_needs(1000, 11, ContactLaw(friction=0.0), Solver()).unknowns_per_contact
    1
    """
    friction = max(law.friction, wall_friction) > 0.0
    parts = (
        ("sweeps", True, "over the contacts, one after the other", ""),
        ("friction", friction, "Coulomb's limit at each contact", "no friction is given"),
        ("rotation", friction, "spins and moments of inertia", "nothing turns the grains"),
        ("cell strain", strained, "rates along the axes, branches", "no cell strains"),
        ("springs", law.compliance > 0.0, "of compliant contacts", "contacts are rigid"),
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
        choices=tuple(choose(*part) for part in parts),
        state_variables=("position", "velocity", *spin, "impulse of each contact"),
        fields=("position", "velocity", *spin, "contact force"),
        libraries=("numba",),
        memory=grains * (PER_GRAIN + PER_UNKNOWN * unknowns + PER_FRAME * frames),
    )

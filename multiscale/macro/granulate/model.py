"""What is computed: how grains touch, what acts on them, how the contacts are solved."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from multiscale.errors import CaseError
from multiscale.macro.granulate.contacts import CYLINDER, PLANE
from multiscale.macro.granulate.grain_bodies import Grains, Wall

__all__ = ["ContactLaw", "Model", "Solver"]


@dataclass(frozen=True)
class ContactLaw:
    r"""How grains touch.

    Parameters
    ----------
    friction : float
        Coulomb's coefficient, dimensionless.
    restitution : float
        Newton's, from 0 to 1. Pairs that approach slowly do not bounce.
    compliance : float
        :math:`a` of (1), dimensionless; zero for a rigid contact.
    relaxation : float
        Steps in which an overlap goes, at least 1.

    Raises
    ------
    CaseError
        If a parameter is outside its range.

    Notes
    -----
    A compliant contact of mass :math:`m` moves a little while its impulse :math:`r` differs from
    that of the last step, :math:`r^-`, along the normal and across it:

    .. math:: u + b + \frac{a}{m} (r - r^-) = 0 \quad \text{instead of} \quad u + b = 0.    \tag{1}

    It is a spring of the stiffness :math:`m / (a h^2)` in a step of length h, but it forgets:
    at rest nothing overlaps. It changes the problem that is solved, which then takes far fewer
    sweeps, with 0.02 a fourth or less. Where an impact would make grains overlap by more than 0.8 %
    of a radius, the contact is stiffened for this step; one that bounces is rigid, and so keeps its
    restitution. Pushing grains apart again brings the energy that their overlap has kept.
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
    """How the contacts of a step are solved.

    Parameters
    ----------
    tolerance : float
        Natural-map error relative to the velocities of the contacts that would close;
        dimensionless.
    max_iterations : int
        Limit of sweeps in a step.
    threads : int
        1 sweeps in the order of the contacts, more colour by colour.
    most_assembled : int
        A step of at most so many contacts that the sweeps do not solve is given to
        :func:`multiscale.nonsmooth.solve_friction`.
    """

    tolerance: float = 1e-4
    max_iterations: int = 1000
    threads: int = 1
    most_assembled: int = 400

    def __post_init__(self) -> None:
        if not 0.0 < self.tolerance < 1.0:
            raise CaseError(f"tolerance must lie between 0 and 1, got {self.tolerance:g}")
        for name in ("max_iterations", "threads"):
            if getattr(self, name) < 1:
                raise CaseError(f"{name} must be at least 1, got {getattr(self, name)}")


@dataclass(frozen=True)
class Model:
    """Grains and walls with what acts on them.

    Parameters
    ----------
    grains : Grains
    walls : tuple of Wall
    law : ContactLaw
    gravity : array_like, shape (3,)
        m/s2.
    period : array_like, shape (3,)
        Length after which space repeats, m; infinite where it does not.
    damping_rate : float
        1/s, at which grains lose velocity; infinite for quasi-static motion, in which a step keeps
        no velocity of the last.
    pressure : float, optional
        On a periodic cell without walls, which strains alike along its axes, Pa; a cell of given
        size if not given.
    strain_rate : tuple of float, optional
        Rates of the logarithmic strain of such a cell along its axes, 1/s, extension positive;
        ``None`` where the pressure rules.

    Raises
    ------
    CaseError
        If the damping or the pressure is refused.
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
        """Along which axes space repeats."""
        return np.array([bool(np.isfinite(length)) for length in self.period])

    @cached_property
    def free(self) -> np.ndarray:
        """Along which axes the cell strains under its pressure."""
        told = np.array([rate is not None for rate in self.strain_rate])
        return self.strained & ~told if self.pressure is not None else np.zeros(3, bool)

    @property
    def driven(self) -> bool:
        """Whether a strain rate of the cell is given."""
        return any(rate is not None for rate in self.strain_rate)

    @cached_property
    def told_rate(self) -> np.ndarray:
        """Rates of strain that are given, zero elsewhere, shape (3,), 1/s."""
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
    def friction(self) -> np.ndarray | None:
        """Coefficients of the grains and of each wall, shape (1 + walls,), if there is friction."""
        if not self.frictional:
            return None
        own = self.law.friction
        return np.array([own, *(own if w.friction is None else w.friction for w in self.walls)])

    @cached_property
    def mobility(self) -> np.ndarray:
        """Rows of :mod:`multiscale.macro.granulate.sweeps`, 1/kg."""
        grains, turns = self.grains, self.turns
        mobility = np.zeros((grains.n + len(self.walls), 3 if turns else 1))
        mobility[: grains.n, :2] = 1.0 / grains.mass[:, None]
        if turns:
            mobility[: grains.n, 2] = grains.radius**2 / grains.inertia
        mobility[grains.n :, 0] = [wall.mobility for wall in self.walls]
        return mobility

    @cached_property
    def masses(self) -> np.ndarray:
        """What moves with the bodies, in the shape of their velocities, kg; zero for walls told."""
        masses, mobility = np.zeros_like(self.push), self.mobility
        moves = mobility[:, 0] > 0.0
        masses[moves, :3] = 1.0 / mobility[moves, :1]
        if self.turns:
            turns = mobility[:, 2] > 0.0
            masses[turns, 4:7] = 1.0 / mobility[turns, 2:]
        return masses

    @cached_property
    def shapes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Kind, direction and radius of the walls."""
        axis = np.array([wall.unit for wall in self.walls]).reshape(-1, 3)
        bore = np.array([wall.bore for wall in self.walls], float)
        return np.where(bore > 0.0, CYLINDER, PLANE), axis, bore

    @cached_property
    def push(self) -> np.ndarray:
        """Acceleration of the bodies without contacts, in the shape of their velocities, m/s2."""
        push = np.zeros((self.mobility.shape[0], 8 if self.turns else 4))
        push[: self.grains.n, :3] = self.gravity
        for w, wall in enumerate(self.walls, self.grains.n):
            push[w, :3] = wall.acceleration
        return push

    def walls_at(self, point: np.ndarray) -> tuple[np.ndarray, ...]:
        """Arrays of the walls for the kernels."""
        kind, axis, bore = self.shapes
        return kind, point, axis, bore

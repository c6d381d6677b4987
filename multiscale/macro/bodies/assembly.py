"""Elastic bodies with interfaces, initial gaps, rigid plates and bolts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.fe.faces import face_of
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.continuum.body import Body, Value

ASIDE = 0.01
"""Misalignment up to which washers are opposite: distance of their centres across the axis relative
to their size, and 1 less the cosine of their normals to the axis."""


@dataclass(frozen=True)
class Platen:
    """A rigid plate on a boundary of a body, which moves along one axis and may tilt.

    Along the other axes the nodes of the boundary are free, or fixed by supports of the body. The
    unknown of a guided plate is its displacement. A tilting plate has three unknowns, the
    displacements of its centre and of the ends of its half-lengths along the two other axes, so
    that they transform in rigid motions as displacements of nodes do.

    Attributes
    ----------
    force : float or callable, along the axis, N; in the form of the tractions of a body
    point : tuple of float, optional
        Point of action of the force, m: the plate tilts freely. It is guided if not given.
    axis : int, default 2, along which it moves
    """

    body: int
    boundary: str
    force: Value
    point: tuple[float, float, float] | None = None
    axis: int = 2

    def positions(self, body: Body) -> np.ndarray:
        """Points of the unknowns of the plate, displacements along the axis, (3, k), m."""
        nodes = body.basis.doflocs[:, body.nodes(self.boundary)]
        low, high = nodes.min(axis=1), nodes.max(axis=1)
        middle = 0.5 * (low + high)
        if self.point is None:
            return np.asarray(middle[:, None])
        first, second = (axis for axis in range(3) if axis != self.axis)
        ends = np.eye(3)[[first, second]] * (high - middle)
        return np.column_stack([middle, middle + ends[0], middle + ends[1]])

    def motion(self, body: Body, position: np.ndarray) -> np.ndarray:
        """Displacement along the axis of points (3, m) from the unknowns, shape (m, k)."""
        unknowns = self.positions(body)
        if self.point is None:
            return np.ones((position.shape[1], 1))
        across = [axis for axis in range(3) if axis != self.axis]
        half = np.diag(unknowns[across, 1:] - unknowns[across, :1])
        tilts = ((position[across] - unknowns[across, :1]) / half[:, None]).T
        return np.asarray(np.column_stack([1.0 - tilts.sum(axis=1), tilts]))

    def arm(self, body: Body) -> np.ndarray:
        """Displacement of the point of the force from the unknowns, shape (k,)."""
        at = self.positions(body)[:, 0] if self.point is None else np.array(self.point)
        return np.asarray(self.motion(body, at[:, None])[0])


@dataclass(frozen=True)
class Bolt:
    r"""A bolt through bodies, from the face under its head to the face under its nut.

    Both washers are rigid and tilt. The shank carries no shear. While the bolt is tightened it
    pulls the washers together by the force :math:`F`; then it is locked, and its force

    .. math:: N = F + k (\delta - \delta_0)    \tag{1}

    follows the distance :math:`\delta` of the washers and its value :math:`\delta_0` at locking.

    Parameters
    ----------
    sides : tuple of int, the bodies under head and nut
    boundaries : tuple of str
        Plane faces under the washers, with normals away from each other along x, y or z.
    stiffness : float, axial stiffness :math:`k` of the shank, N/m; see :func:`shank_stiffness`
    preload : float, force :math:`F` at the factor 1 of the tightening, N
    """

    sides: tuple[int, int]
    boundaries: tuple[str, str]
    stiffness: float
    preload: float

    def __post_init__(self) -> None:
        require("the stiffness of a bolt", self.stiffness, "(0, inf)", "N/m")
        if self.sides[0] == self.sides[1]:
            raise CaseError(
                f"a bolt between two faces of body {self.sides[0]} has no effect; choose faces of "
                f"two bodies"
            )
        if not 0.0 < self.preload < np.inf:
            raise CaseError(
                f"a bolt needs a positive preload (N) that presses its washers on, got "
                f"{self.preload:g}"
            )

    def name(self, bodies: Sequence[Body]) -> str:
        """Name the bolt by the faces under its washers, in words."""
        ends = zip(self.sides, self.boundaries, strict=True)
        return f"the bolt from {' to '.join(bodies[k].face_name(face, k) for k, face in ends)}"

    def washers(self, bodies: Sequence[Body]) -> tuple[Platen, Platen]:
        """Rigid plates under the bolt, in the order of their positions along its axis."""
        # centres and normals of both faces, in the order along the axis
        washers = []
        for body, name in zip(self.sides, self.boundaries, strict=True):
            face = face_of(bodies[body].mesh, name)
            x = face.position
            middle, normal = 0.5 * (x.min(axis=0) + x.max(axis=0)), face.normals.sum(axis=0)
            washers.append((middle, normal, float(np.ptp(x, axis=0).max()), body, name))
        apart = washers[1][0] - washers[0][0]
        axis = int(np.argmax(np.abs(apart)))
        if apart[axis] < 0.0:
            washers.reverse()

        # distance of the centres across the axis, and directions of the normals
        aside = float(np.linalg.norm(np.delete(apart, axis)))
        (_, down, size, *_), (_, up, other, *_) = washers
        facing = [0.0 - down[axis] / np.linalg.norm(down), up[axis] / np.linalg.norm(up)]
        if aside > ASIDE * max(size, other) or min(facing) < 1.0 - ASIDE:
            raise CaseError(
                f"{self.name(bodies)} has wrong faces: its washers must face away from each "
                f"other along {'xyz'[axis]} (cosines {facing[0]:.2g} and {facing[1]:.2g}) and lie "
                f"above each other (centres {aside:.2g} m aside)"
            )
        first, second = (
            Platen(body, name, 0.0, tuple(middle.tolist()), axis)
            for middle, _, _, body, name in washers
        )
        return first, second


@dataclass(frozen=True)
class BoltSection:
    r"""Cut across the meshed shank of a bolt, where its force acts.

    With the mean :math:`\bar u_1` of the displacement along the axis over the nodes of side 1, and
    the displacement s of the centre of side 2, the nodes of side 2 move as the nodes of side 1, but
    along the axis by

    .. math:: u_2 = u_1 - \bar u_1 + s.    \tag{1}

    The tension pulls s and :math:`\bar u_1` together and is constant: the bolt bends and shears
    with the bodies, and does not resist their change of thickness.

    Parameters
    ----------
    sides : tuple of int, the bodies
    boundaries : tuple of str, plane faces of the cut, across x, y or z, with matching nodes
    preload : float, tension at the factor 1 of the tightening, N
    """

    sides: tuple[int, int]
    boundaries: tuple[str, str]
    preload: float

    def __post_init__(self) -> None:
        if self.sides[0] == self.sides[1] or not 0.0 < self.preload < np.inf:
            raise CaseError(
                f"a cut through a bolt needs two bodies and a positive preload (N), got bodies "
                f"{self.sides[0]} and {self.sides[1]} and {self.preload:g}"
            )

    def nodes(self, bodies: Sequence[Body]) -> tuple[np.ndarray, np.ndarray, int, float]:
        """Return matching nodes of both sides, the axis, and the direction of the normal of side 2.

        The direction is 1 along the axis, else -1.
        """
        from scipy.spatial import cKDTree

        lower, upper = (bodies[side] for side in self.sides)
        first, second = (
            body.nodes(face) for body, face in zip((lower, upper), self.boundaries, strict=True)
        )
        x = upper.basis.doflocs[:, second]
        apart, nearest = cKDTree(lower.basis.doflocs[:, first].T).query(x.T)
        extent = np.ptp(x, axis=1)
        axis, size = int(np.argmin(extent)), float(extent.max())
        if first.size != second.size or max(apart.max(), extent[axis]) > 1e-6 * size:
            raise CaseError(
                f"the cut through a bolt, {lower.face_name(self.boundaries[0], self.sides[0])} and "
                f"{upper.face_name(self.boundaries[1], self.sides[1])}, has {first.size} and "
                f"{second.size} nodes up to {max(apart.max(), extent[axis]):.2g} m apart; mesh "
                f"both faces with equal meshes, in a plane across an axis"
            )
        face = face_of(upper.mesh, self.boundaries[1])
        direction = float(np.sign(face.normals.sum(axis=0)[axis]))
        return first[nearest], second, axis, direction


def shank_stiffness(diameter: float, length: float, youngs_modulus: float) -> float:
    r"""Axial stiffness of a round shank, :math:`E \pi d^2 / (4 l)`, N/m.

    Parameters
    ----------
    diameter, length : float, m
    youngs_modulus : float, Pa

    Examples
    --------
    >>> round(shank_stiffness(8e-3, 20e-3, 210e9) / 1e6)  # N/µm
    528
    """
    if not min(diameter, length, youngs_modulus) > 0.0:
        raise CaseError(
            f"diameter, length and youngs_modulus of a shank must be positive (m, m, Pa), got "
            f"{diameter:g}, {length:g} and {youngs_modulus:g}"
        )
    return 0.25 * np.pi * diameter**2 * youngs_modulus / length


GROUND = (None, None)  # body and boundary of the first side of an interface with the rigid ground

NEAR, FINE = 3.0, 0.1
"""Largest distance of the interface from defined points of a map, in spacings of the map and
relative to the size of the interface."""

PLAUSIBLE = 0.02
"""Largest range of a gap relative to the size of the interface; a larger range suggests a wrong
unit."""


@dataclass(frozen=True, eq=False)
class GapMap:
    """Initial gap at points of an interface, linear between them.

    Parameters
    ----------
    position : ndarray, shape (n, 2)
        Points of the map, m, along the two axes of the structure in the plane of the interface: x
        and y where its normal is z.
    gap : ndarray, shape (n,), gap, m, NaN where it is undefined, such as in holes
    name : str, in messages
    """

    position: np.ndarray
    gap: np.ndarray
    name: str = "the map of the gap"

    def __post_init__(self) -> None:
        if not np.count_nonzero(np.isfinite(self.gap)) >= 3:
            raise CaseError(
                f"{self.name} has {np.count_nonzero(np.isfinite(self.gap))} defined points, and a "
                f"gap over an interface needs three or more"
            )

    def at(self, place: np.ndarray) -> np.ndarray:
        """Return the gap at points of the interface, m.

        Parameters
        ----------
        place : ndarray, shape (points, 3), m, in a plane across x, y or z
        """
        from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
        from scipy.spatial import cKDTree

        # places in the plane of the interface, and coverage by defined points
        axes = np.sort(np.argsort(np.ptp(place, axis=0))[1:])
        x, defined = place[:, axes], np.isfinite(self.gap)
        points = self.position[defined]
        spacing = np.median(cKDTree(self.position).query(self.position, 2)[0][:, 1])
        size = float(np.ptp(x, axis=0).max())
        covered = cKDTree(points).query(x)[0] <= min(NEAR * spacing, FINE * size)
        if not covered.all():
            raise CaseError(
                f"{self.name} covers {covered.mean():.3g} of the interface: its defined points are "
                f"{_extents(points)}, and the interface {_extents(x)}; give a map of the whole "
                f"interface in the coordinates of the structure, and its unit"
            )

        # linear inside the map, nearest point at its edge
        values = self.gap[defined]
        gap = LinearNDInterpolator(points, values)(x)
        gap = np.where(np.isnan(gap), NearestNDInterpolator(points, values)(x), gap)
        if np.ptp(gap) > PLAUSIBLE * size:
            raise CaseError(
                f"{self.name} varies by {np.ptp(gap):.3g} m over an interface of {size:.3g} m, "
                f"more than {PLAUSIBLE:g} of it; give the unit of the gaps"
            )
        return np.asarray(gap)


def _extents(x: np.ndarray) -> str:
    low, high = x.min(axis=0), x.max(axis=0)
    return " by ".join(f"from {a:.4g} to {b:.4g} m" for a, b in zip(low, high, strict=True))


@dataclass(frozen=True)
class Interface:
    """A law between boundaries of two bodies, or of a body and the ground.

    Where the nodes of the boundaries do not match, or elements are of second order, the law acts on
    averages of the jump about the corners of the facets of side 2 (of side 1 where the facets of
    side 2 are more than four times as large), so that a patch under uniform stress is exact. If the
    boundaries do not match, at least half of the smaller boundary must lie on the other: plates
    that overlap need a separate boundary for the overlap.

    Attributes
    ----------
    sides : tuple of int
        The bodies; the jump is the displacement of the second minus the displacement of the first.
        None as the first side is the rigid ground.
    boundaries : tuple of str, name of the boundary in each body; None of the ground
    law : InterfaceLaw, of any kind: frictionless, with sliders, hysteretic, damaged, rigid
    quadrature_order : int, optional
        On matching boundaries the law acts at Gauss points that integrate this degree exactly; at
        nodes or averages if not given, where the tractions of stiff laws do not oscillate.
    gap : GapMap, optional, initial gap in addition to the gap of the law
    """

    sides: tuple[int | None, int]
    boundaries: tuple[str | None, str]
    law: InterfaceLaw
    quadrature_order: int | None = None
    gap: GapMap | None = None


@dataclass(frozen=True)
class Assembly:
    """Elastic bodies, interfaces between their named faces, supports and load cases.

    Parameters
    ----------
    bodies : sequence of Body, linear elastic, in three dimensions, with supports that do not move
    interfaces : sequence of Interface, laws between the bodies
    times : sequence of float, default (1.0,)
        A load case for each: the tractions of the bodies and the forces of the platens at that
        time.
    areas : sequence of float, optional
        Areas of the loaded faces of all load cases, m², for displacements of loaded faces as in
        :func:`~multiscale.macro.substructures.load_joint`.
    platens : sequence of Platen, rigid plates on the bodies
    bolts : sequence of Bolt
        The first load case tightens them together: steps that change its factor tighten, or
        loosen, the bolts to that factor times their preloads; in other steps they are locked.
    sections : sequence of BoltSection
        Cuts through meshed bolts, tightened by the same load case; their tension does not change
        with other loads.
    """

    bodies: Sequence[Body]
    interfaces: Sequence[Interface] = ()
    times: Sequence[float] = (1.0,)
    areas: Sequence[float] = ()
    platens: Sequence[Platen] = ()
    bolts: Sequence[Bolt] = ()
    sections: Sequence[BoltSection] = ()

    def __post_init__(self) -> None:
        named: list[tuple[str, int | None, str | None]] = []
        for i, interface in enumerate(self.interfaces):
            first, second = zip(interface.sides, interface.boundaries, strict=True)
            named += [(f"interface {i}", *side) for side in (first, second)[first == GROUND :]]
        named += [
            (f"platen {i}", platen.body, platen.boundary) for i, platen in enumerate(self.platens)
        ]
        shanks: list[Bolt | BoltSection] = [*self.bolts, *self.sections]
        for i, bolt in enumerate(shanks):
            named += [(f"bolt {i}", *end) for end in zip(bolt.sides, bolt.boundaries, strict=True)]
        for name, body, boundary in named:
            if body is None or boundary is None or not 0 <= body < len(self.bodies):
                raise CaseError(
                    f"{name} names body {body}; there are {len(self.bodies)}, counted from 0"
                )
            self.bodies[body].check_boundary(boundary)
        for bolt in self.bolts:
            bolt.washers(self.bodies)
        cases = len(self.times) + bool(self.bolts or self.sections)
        if self.areas and len(self.areas) != cases:
            raise CaseError(
                f"areas must have an entry for each of {cases} load cases, got {len(self.areas)}"
            )

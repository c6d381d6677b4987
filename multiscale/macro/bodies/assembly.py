"""Elastic bodies with interfaces, initial gaps, rigid plates and bolts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.bodies.bolt import Bolt, BoltSection, Platen
from multiscale.macro.continuum.body import Body

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

    Raises
    ------
    CaseError
        If the map has fewer than three defined points.
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

        Raises
        ------
        CaseError
            If the map does not cover the interface, because of its extents or undefined points, or
            its gap is too large for the interface, which suggests a wrong unit.
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
                f"{self.name} covers {covered.mean():.3g} of the interface: its defined points lie "
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
    """Extents of points in a plane."""
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

    Raises
    ------
    CaseError
        If an interface, a platen or a bolt names a body or boundary that does not exist, the
        washers of a bolt are not opposite each other, or the areas do not fit.
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

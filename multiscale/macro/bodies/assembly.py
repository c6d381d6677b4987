"""What every solver for elastic bodies with interfaces takes."""

from collections.abc import Sequence
from dataclasses import dataclass

from multiscale.errors import CaseError
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.bodies.bolt import Bolt, BoltSection
from multiscale.macro.bodies.gap_map import GapMap
from multiscale.macro.bodies.platen import Platen
from multiscale.macro.continuum.body import Body

__all__ = ["Assembly", "Interface"]

GROUND = (None, None)
"""Body and boundary of the first side of an interface with the rigid ground."""


@dataclass(frozen=True)
class Interface:
    """A law between boundaries of two bodies, or of one and the ground.

    Where the nodes of the boundaries do not match, or elements are of second order, the law acts on
    averages of the jump about the corners of the facets of side 2 (of side 1 where the facets of
    side 2 are more than four times as large), so that a patch under even stress is exact. Of
    boundaries that do not match, at least half of the smaller one must lie on the other: of plates
    that lap, the parts that meet are boundaries of their own.

    Attributes
    ----------
    sides : tuple of int
        The bodies; the jump is the displacement of the second minus the displacement of the first.
        None as the first side is the rigid ground.
    boundaries : tuple of str, name of the boundary in each body; None of the ground
    law : InterfaceLaw, of any kind: frictionless, with sliders, hysteretic, damaged, rigid
    quadrature_order : int, optional
        The law acts at Gauss points that integrate this degree exactly, of boundaries that match;
        at nodes or averages if not given, where the tractions of stiff laws do not oscillate.
    gap : GapMap, optional, initial gap beside the gap of the law
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
        One load case for each: the tractions of the bodies and the forces of the platens at that
        time.
    areas : sequence of float, optional
        Of the face on which each load case acts, m²; where displacements of loaded faces are
        wanted, as in :func:`~multiscale.macro.substructures.load_joint`.
    platens : sequence of Platen, rigid plates on the bodies
    bolts : sequence of Bolt
        Their tightening, all together, is a load case before the others: steps that change its
        factor tighten, or loosen, the bolts to that factor times their preloads, and steps that
        keep it find them locked.
    sections : sequence of BoltSection
        Cuts through bolts that are meshed, tightened by the same load case; their tension does
        not change with other loads.

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
        named += [(f"platen {i}", one.body, one.boundary) for i, one in enumerate(self.platens)]
        ends = [(one.sides, one.boundaries) for one in self.bolts]
        ends += [(one.sides, one.boundaries) for one in self.sections]
        for i, (sides, boundaries) in enumerate(ends):
            named += [(f"bolt {i}", *side) for side in zip(sides, boundaries, strict=True)]
        for what, body, boundary in named:
            if body is None or boundary is None or not 0 <= body < len(self.bodies):
                raise CaseError(
                    f"{what} names body {body}; there are {len(self.bodies)}, counted from 0"
                )
            self.bodies[body].check_boundary(boundary)
        for bolt in self.bolts:
            bolt.washers(self.bodies)
        cases = len(self.times) + bool(self.bolts or self.sections)
        if self.areas and len(self.areas) != cases:
            raise CaseError(
                f"areas must be one for each of {cases} load cases, got {len(self.areas)}"
            )

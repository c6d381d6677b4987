"""What every solver for elastic bodies with interfaces takes."""

from collections.abc import Sequence
from dataclasses import dataclass

from multiscale.errors import CaseError
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.continuum.body import Body

__all__ = ["Assembly", "Interface"]


@dataclass(frozen=True)
class Interface:
    """A law between boundaries of two bodies whose meshes match there.

    Attributes
    ----------
    sides : tuple of int
        The bodies; the jump is the displacement of the second minus the displacement of the first.
    boundaries : tuple of str
        Name of the boundary in each.
    law : InterfaceLaw
        Of any kind: frictionless, with sliders, hysteretic, damaged, rigid.
    """

    sides: tuple[int, int]
    boundaries: tuple[str, str]
    law: InterfaceLaw


@dataclass(frozen=True)
class Assembly:
    """Elastic bodies, interfaces between their named faces, supports and load cases.

    Parameters
    ----------
    bodies : sequence of Body
        Linear elastic, in three dimensions, with supports that do not move.
    interfaces : sequence of Interface
        Laws between the bodies.
    times : sequence of float, default (1.0,)
        One load case for each: the tractions of the bodies at that time.
    areas : sequence of float, optional
        Of the face on which each load case acts, m²; where displacements of loaded faces are
        wanted, as in :func:`~multiscale.macro.substructures.load_joint`.

    Raises
    ------
    CaseError
        If an interface names a body or boundary that does not exist, or the areas do not fit.
    """

    bodies: Sequence[Body]
    interfaces: Sequence[Interface] = ()
    times: Sequence[float] = (1.0,)
    areas: Sequence[float] = ()

    def __post_init__(self) -> None:
        for place, interface in enumerate(self.interfaces):
            for side, boundary in zip(interface.sides, interface.boundaries, strict=True):
                if not 0 <= side < len(self.bodies):
                    raise CaseError(
                        f"interface {place} names body {side}; there are {len(self.bodies)}, "
                        f"counted from 0"
                    )
                self.bodies[side].check_boundary(boundary)
        if self.areas and len(self.areas) != len(self.times):
            raise CaseError(
                f"areas must be one for each of {len(self.times)} load cases, got {len(self.areas)}"
            )

"""What every solver for elastic bodies with interfaces takes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.continuum.body import Body, Value

__all__ = ["Assembly", "Interface", "Platen"]

GROUND = (None, None)
"""Body and boundary of the first side of an interface with the rigid ground."""


@dataclass(frozen=True)
class Interface:
    """A law between boundaries of two bodies whose meshes match there, or of one and the ground.

    Attributes
    ----------
    sides : tuple of int
        The bodies; the jump is the displacement of the second minus the displacement of the first.
        None as the first side is the rigid ground.
    boundaries : tuple of str
        Name of the boundary in each body; None of the ground.
    law : InterfaceLaw
        Of any kind: frictionless, with sliders, hysteretic, damaged, rigid.
    quadrature_order : int, optional
        The law acts at Gauss points that integrate this degree exactly; at the nodes if not given,
        where the tractions of stiff laws do not oscillate.
    """

    sides: tuple[int | None, int]
    boundaries: tuple[str | None, str]
    law: InterfaceLaw
    quadrature_order: int | None = None


@dataclass(frozen=True)
class Platen:
    """A rigid plate on a boundary of a body, which moves along one axis and may tilt.

    Along the other axes the nodes of the boundary are free, or held by the supports of the body. A
    plate that is guided has one unknown, its displacement. One that tilts has three, which are its
    displacements at its middle and at the ends of its half-lengths along the two other axes, so
    that they move with a rigid body as the displacements of nodes do.

    Attributes
    ----------
    body : int
    boundary : str
    force : float or callable
        Along the axis, N; in the form of the tractions of a body.
    point : tuple of float, optional
        Where the force acts, m: the plate tilts freely. It is guided if not given.
    axis : int, default 2
        Along which it moves.
    """

    body: int
    boundary: str
    force: Value
    point: tuple[float, float, float] | None = None
    axis: int = 2

    def positions(self, body: Body) -> np.ndarray:
        """Points of the plate whose displacements along the axis are its unknowns, (3, k), m."""
        nodes = body.basis.doflocs[:, body.nodes(self.boundary)]
        low, high = nodes.min(axis=1), nodes.max(axis=1)
        middle = 0.5 * (low + high)
        if self.point is None:
            return np.asarray(middle[:, None])
        first, second = (axis for axis in range(3) if axis != self.axis)
        ends = np.eye(3)[[first, second]] * (high - middle)
        return np.column_stack([middle, middle + ends[0], middle + ends[1]])

    def motion(self, body: Body, position: np.ndarray) -> np.ndarray:
        """Displacement along the axis that its unknowns give to points (3, m), shape (m, k)."""
        unknowns = self.positions(body)
        if self.point is None:
            return np.ones((position.shape[1], 1))
        across = [axis for axis in range(3) if axis != self.axis]
        half = np.diag(unknowns[across, 1:] - unknowns[across, :1])
        tilts = ((position[across] - unknowns[across, :1]) / half[:, None]).T
        return np.asarray(np.column_stack([1.0 - tilts.sum(axis=1), tilts]))

    def arm(self, body: Body) -> np.ndarray:
        """Displacement of the force that its unknowns give, shape (k,)."""
        at = self.positions(body)[:, 0] if self.point is None else np.array(self.point)
        return np.asarray(self.motion(body, at[:, None])[0])


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
        One load case for each: the tractions of the bodies and the forces of the platens at that
        time.
    areas : sequence of float, optional
        Of the face on which each load case acts, m²; where displacements of loaded faces are
        wanted, as in :func:`~multiscale.macro.substructures.load_joint`.
    platens : sequence of Platen
        Rigid plates on the bodies.

    Raises
    ------
    CaseError
        If an interface or a platen names a body or boundary that does not exist, or the areas do
        not fit.
    """

    bodies: Sequence[Body]
    interfaces: Sequence[Interface] = ()
    times: Sequence[float] = (1.0,)
    areas: Sequence[float] = ()
    platens: Sequence[Platen] = ()

    def __post_init__(self) -> None:
        named: list[tuple[str, int | None, str | None]] = []
        for i, interface in enumerate(self.interfaces):
            first, second = zip(interface.sides, interface.boundaries, strict=True)
            named += [(f"interface {i}", *side) for side in (first, second)[first == GROUND :]]
        named += [(f"platen {i}", one.body, one.boundary) for i, one in enumerate(self.platens)]
        for what, body, boundary in named:
            if body is None or boundary is None or not 0 <= body < len(self.bodies):
                raise CaseError(
                    f"{what} names body {body}; there are {len(self.bodies)}, counted from 0"
                )
            self.bodies[body].check_boundary(boundary)
        if self.areas and len(self.areas) != len(self.times):
            raise CaseError(
                f"areas must be one for each of {len(self.times)} load cases, got {len(self.areas)}"
            )

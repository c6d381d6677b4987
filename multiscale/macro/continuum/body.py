"""Elastic or plastic body: mesh, bulk law, supports and loads."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.fe.elasticity import displacement_basis
from multiscale.fe.faces import check_boundary
from multiscale.fe.mesh_file import load_mesh as load_mesh
from multiscale.laws.bulk import BulkLaw

if TYPE_CHECKING:
    from skfem import CellBasis, Element, Mesh

Value = float | Callable[[np.ndarray, float], np.ndarray | float]
"""A number that grows in proportion to time, or a function ``value(position, time)``."""

Supports = Mapping[str, Sequence[Value | None]]
"""Displacement of the components on boundaries; None leaves a component free."""

Pins = Mapping[tuple[float, ...], Sequence[Value | None]]
"""Displacement of the components of single nodes, by their positions."""

ASTRAY = 1e-6  # distance of a pin from its node, relative to the size of the body, that is rounding

ELEMENTS = {"MeshTri1": "triangles", "MeshQuad1": "quadrilaterals", "MeshTet1": "tetrahedra"} | {
    "MeshHex1": "hexahedra"
}


@dataclass(frozen=True)
class Body:
    """A body in contact.

    Parameters
    ----------
    mesh : Mesh
        scikit-fem mesh of straight triangles, quadrilaterals (plane strain, per metre of depth),
        tetrahedra or hexahedra with named boundaries.
    law : BulkLaw, for instance ``Elastic(210e9, 0.3)``
    supports : mapping of str to sequence
        For a boundary, the prescribed displacement of each component, m; ``None`` leaves a
        component free. A number is multiplied by the time of the step, a function is called
        with the positions, shape (d, nodes), m, and the time.
    tractions : mapping of str to sequence
        For a boundary, the components of a dead load per undeformed area, Pa, in the same form.
    element : Element, optional
        Scalar scikit-fem element of every displacement component, for instance ``ElementHex2()``;
        the corners of the mesh are its nodes if not given. Its unknowns are the nodes of the body.
    pins : mapping of tuple to sequence
        For the position of a single node, m, its prescribed displacement, as in ``supports``.
    name : str, in messages
    share : ndarray, shape (elements,), optional
        Remaining share of the stiffness of every element, above 0; 1 if not given. For solvers of
        linear elastic bodies.
    bends : bool, default False
        Whether hexahedra of first order have incompatible modes, without which they bend too
        stiffly; see :func:`~multiscale.fe.elasticity.mode_stiffness`. For bodies that are cut.
    """

    mesh: "Mesh"
    law: BulkLaw
    supports: Supports = field(default_factory=dict)
    tractions: Mapping[str, Sequence[Value]] = field(default_factory=dict)
    element: "Element | None" = None
    pins: Pins = field(default_factory=dict)
    name: str = ""
    share: np.ndarray | None = None
    bends: bool = False

    def __post_init__(self) -> None:
        kind = type(self.mesh).__name__
        if kind not in ELEMENTS:
            raise CaseError(
                f"a body in contact needs a mesh of straight {', '.join(ELEMENTS.values())}, "
                f"got {kind}"
            )
        dim = self.mesh.dim()
        for boundary in (*self.supports, *self.tractions):
            self.check_boundary(boundary)
        tables: dict[str, Mapping[Any, Sequence[Value | None]]] = {
            "support": self.supports,
            "traction": self.tractions,
            "pin": self.pins,
        }
        for kind, table in tables.items():
            for name, values in table.items():
                if len(values) != dim:
                    raise CaseError(
                        f"the {kind} on {name!r} needs {dim} components, got {len(values)}"
                    )
                for value in values:
                    if value is not None and not callable(value) and not np.isfinite(value):
                        raise CaseError(f"the {kind} on {name!r} must be finite, got {value}")

    def check_boundary(self, name: str) -> None:
        """Refuse a boundary that is unknown in the mesh."""
        check_boundary(self.mesh, name)

    def face_name(self, boundary: str, number: int) -> str:
        """Name of a boundary in messages, with the number of a body without name."""
        return f"{self.name}.{boundary}" if self.name else f"{boundary!r} of body {number}"

    @cached_property
    def basis(self) -> "CellBasis":
        """Finite-element space of a displacement component."""
        return displacement_basis(self.mesh, self.element or self.mesh.elem())

    def nodes(self, boundary: str) -> np.ndarray:
        """Numbers of the nodes of a boundary, rising."""
        self.check_boundary(boundary)
        return np.unique(self.basis.get_dofs(boundary).all())


def evaluate(value: Value, position: np.ndarray, time: float, name: str) -> np.ndarray:
    """Value at points of shape (d, n) and a time; refuses values that are not finite."""
    result = value(position, time) if callable(value) else value * time
    result = np.broadcast_to(np.asarray(result, dtype=float), position.shape[1:])
    if not np.all(np.isfinite(result)):
        raise CaseError(f"{name} is NaN or infinite at time {time:g}")
    return result


def fixed_motion(body: Body, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Prescribed unknowns d a + i of a body and their displacement at a time, m."""
    position = body.basis.doflocs
    motion = np.full(position.shape, np.nan)
    supports = [
        (f"the support on {face!r}", body.nodes(face), body.supports[face])
        for face in body.supports
    ]
    supports += [
        (f"the pin at {point}", _node(body, point), body.pins[point]) for point in body.pins
    ]
    for name, nodes, values in supports:
        for i, value in enumerate(values):
            if value is not None:
                motion[i, nodes] = evaluate(value, position[:, nodes], time, name)
    flat = motion.T.ravel()
    fixed = np.flatnonzero(~np.isnan(flat))
    return fixed, flat[fixed]


def _node(body: Body, point: Sequence[float]) -> np.ndarray:
    position = body.basis.doflocs
    distance = np.linalg.norm(position - np.reshape(point, (-1, 1)), axis=0)
    if distance.min() > ASTRAY * float(np.ptp(position, axis=1).max()):
        raise CaseError(
            f"no node is at the pin {tuple(point)} m (nearest {distance.min():.2g} m away); move "
            f"the pin to a node"
        )
    return np.array([np.argmin(distance)])


def load_vector(body: Body, time: float) -> np.ndarray:
    """Nodal forces of the tractions of a body at a time, N, shape (d * nodes,)."""
    from skfem import FacetBasis

    space, d = body.basis, body.mesh.dim()
    force = np.zeros((space.N, d))
    for name, values in body.tractions.items():
        basis = FacetBasis(body.mesh, space.elem, facets=name, intorder=4, dofs=space.dofs)
        place = np.asarray(basis.global_coordinates())
        for i, value in enumerate(values):
            flat = place.reshape(d, -1)
            load = evaluate(value, flat, time, f"the traction on {name!r}")
            weighted = load.reshape(basis.dx.shape) * basis.dx
            for a, shape in enumerate(basis.basis):
                nodal = np.sum(weighted * np.asarray(shape[0]), axis=1)
                np.add.at(force[:, i], basis.element_dofs[a], nodal)
    return force.ravel()

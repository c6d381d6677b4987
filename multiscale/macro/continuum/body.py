"""An elastic or plastic body: mesh, bulk law, supports and loads."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError
from multiscale.fe.faces import check_boundary
from multiscale.laws.bulk import BulkLaw

if TYPE_CHECKING:
    from skfem import Mesh

__all__ = ["Body", "Value", "evaluate", "fixed_motion", "load_vector"]

Value = float | Callable[[np.ndarray, float], np.ndarray | float]
"""A number that grows in proportion to time, or a function ``value(position, time)``."""

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
    law : BulkLaw
        For instance ``Elastic(210e9, 0.3)``.
    supports : mapping of str to sequence
        For a boundary, the prescribed displacement of each component, m; ``None`` leaves a
        component free. A number is multiplied by the time of the step, a function is called
        with the positions, shape (d, nodes), m, and the time.
    tractions : mapping of str to sequence
        For a boundary, the components of a dead load per undeformed area, Pa, in the same form.

    Raises
    ------
    CaseError
        If the mesh is of another kind, names no such boundary, or a value has the wrong number
        of components or is not finite.
    """

    mesh: "Mesh"
    law: BulkLaw
    supports: Mapping[str, Sequence[Value | None]] = field(default_factory=dict)
    tractions: Mapping[str, Sequence[Value]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        kind = type(self.mesh).__name__
        if kind not in ELEMENTS:
            raise CaseError(
                f"a body in contact takes meshes of straight {', '.join(ELEMENTS.values())}, "
                f"got {kind}"
            )
        dim = self.mesh.dim()
        for what, table in (("support", self.supports), ("traction", self.tractions)):
            for name, values in table.items():
                self.check_boundary(name)
                if len(values) != dim:
                    raise CaseError(
                        f"the {what} on {name!r} needs {dim} components, got {len(values)}"
                    )
                for value in values:
                    if value is not None and not callable(value) and not np.isfinite(value):
                        raise CaseError(f"the {what} on {name!r} must be finite, got {value}")

    def check_boundary(self, name: str) -> None:
        """Refuse a boundary that the mesh does not name."""
        check_boundary(self.mesh, name)


def evaluate(value: Value, position: np.ndarray, time: float, what: str) -> np.ndarray:
    """Value at points of shape (d, n) and a time; refuses values that are not finite."""
    result = value(position, time) if callable(value) else value * time
    result = np.broadcast_to(np.asarray(result, dtype=float), position.shape[1:])
    if not np.all(np.isfinite(result)):
        raise CaseError(f"{what} is NaN or infinite at time {time:g}")
    return result


def fixed_motion(body: Body, time: float) -> tuple[np.ndarray, np.ndarray]:
    """Prescribed unknowns d a + i of a body and their displacement at a time, m."""
    d = body.mesh.dim()
    motion = np.full((d, body.mesh.p.shape[1]), np.nan)
    for name, values in body.supports.items():
        nodes = np.unique(body.mesh.facets[:, body.mesh.boundaries[name]])
        for i, value in enumerate(values):
            if value is not None:
                place = body.mesh.p[:, nodes]
                motion[i, nodes] = evaluate(value, place, time, f"the support on {name!r}")
    flat = motion.T.ravel()
    fixed = np.flatnonzero(~np.isnan(flat))
    return fixed, flat[fixed]


def load_vector(body: Body, time: float) -> np.ndarray:
    """Nodal forces of the tractions of a body at a time, N, shape (d * nodes,)."""
    from skfem import FacetBasis

    d = body.mesh.dim()
    force = np.zeros((body.mesh.p.shape[1], d))
    for name, values in body.tractions.items():
        basis = FacetBasis(body.mesh, body.mesh.elem(), facets=name, intorder=4)
        place = np.asarray(basis.global_coordinates())
        for i, value in enumerate(values):
            flat = place.reshape(d, -1)
            load = evaluate(value, flat, time, f"the traction on {name!r}")
            weighted = load.reshape(basis.dx.shape) * basis.dx
            for a, shape in enumerate(basis.basis):
                nodal = np.sum(weighted * np.asarray(shape[0]), axis=1)
                np.add.at(force[:, i], basis.element_dofs[a], nodal)
    return force.ravel()

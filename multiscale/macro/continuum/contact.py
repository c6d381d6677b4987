r"""Contact surfaces at small or large displacement: obstacles, frames, gap and slip.

With the mortar rows of :mod:`~multiscale.fe.faces`, side 1 with the reaction, and a side 2 that is
a face or a rigid obstacle (D has the areas of the nodes, M is empty), the weighted jump in the
frame :math:`(n, t_1, t_2)` of each node of side 1, and the slip of a step [1]_ with :math:`\bar B`
over the area of the node, are

.. math:: B u = M u_2 - D u_1 ,    \tag{1}

.. math:: s = t \cdot (\bar B^- - \bar B)\, x .    \tag{2}

.. [1] M. A. Puso and T. A. Laursen, Comput. Methods Appl. Mech. Eng. 193 (2004) 4891-4913,
   doi:10.1016/j.cma.2004.06.001.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.sparse import csr_array, diags_array, vstack

from multiscale.errors import CaseError, require
from multiscale.fe.faces import OrientedFace, mortar_rows, nodal_normals, tangent_frames
from multiscale.macro.continuum.body import Value

FACETED = 10.0
"""Least ratio of an overlap to the distance by which facets miss their curved surface."""

ASIDE = 0.02
"""Distance of the nodes of both sides, relative to an edge, up to which their facets match."""

LEAST_AREA = 1e-9
"""Nodes with less than this share of their area opposite side 2 transmit no traction."""

LOCKED = 0.1  # share of the free components of a node along an axis below which it counts as fixed


class RigidObstacle(ABC):
    """Rigid surface that moves without rotation, by ``motion``, m; at rest if it is empty."""

    motion: Sequence[Value] = ()  # numbers times the time, or functions (position, time), m

    @abstractmethod
    def distance(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance (m, negative inside) and outward normal of points, (n, d), at the start."""

    def moved(self, dim: int, time: float) -> np.ndarray:
        """Displacement at a time, shape (dim,), m."""
        if not self.motion:
            return np.zeros(dim)
        if len(self.motion) != dim:
            raise CaseError(
                f"the motion of an obstacle needs {dim} components, got {len(self.motion)}"
            )
        origin = np.zeros((dim, 1))
        values = [v(origin, time) if callable(v) else v * time for v in self.motion]
        motion = np.array([float(np.ravel(np.asarray(v))[0]) for v in values])
        if not np.all(np.isfinite(motion)):
            raise CaseError(f"the motion of an obstacle is NaN or infinite at time {time:g}")
        return motion


@dataclass(frozen=True)
class RigidPlane(RigidObstacle):
    """Half-space.

    Parameters
    ----------
    point, normal : sequence of float
        A point of the plane, m, and its normal out of the obstacle, to the body; of any length.
    """

    point: Sequence[float]
    normal: Sequence[float]
    motion: Sequence[Value] = ()

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.normal))
        if not (length > 0.0 and np.isfinite(length)):
            raise CaseError(f"the normal of a plane needs a direction, got {tuple(self.normal)}")

    def distance(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distance along the normal."""
        n = np.asarray(self.normal) / np.linalg.norm(self.normal)
        return (x - np.asarray(self.point)) @ n, np.broadcast_to(n, x.shape)


@dataclass(frozen=True)
class Contact:
    r"""Contact between two surfaces.

    Parameters
    ----------
    side1 : tuple of str
        Body and boundary that carry the contact traction. The finer mesh belongs here.
    side2 : tuple of str or RigidObstacle
    friction_coefficient : float, default 0.0, Coulomb's :math:`\mu \ge 0`, dimensionless
    finite_sliding : bool, default False
        Whether partners and normals follow the motion. Otherwise they are constant.
    fitted : bool, default False
        Whether the bodies fit at the start. The initial gap between the facets of two curved meshes
        is then an error of the meshes and is subtracted.
    interference : float, default 0.0
        Normal distance by which fitted bodies overlap everywhere at the start, independent of their
        facets, as in a press fit, m.
    """

    side1: tuple[str, str]
    side2: tuple[str, str] | RigidObstacle
    friction_coefficient: float = 0.0
    finite_sliding: bool = False
    fitted: bool = False
    interference: float = 0.0

    def __post_init__(self) -> None:
        require("friction_coefficient", self.friction_coefficient, "[0, inf)")
        if not 0.0 <= self.interference < np.inf or (self.interference and not self.fitted):
            raise CaseError(
                f"the interference of a contact must not be negative (m) and needs fitted=True, "
                f"got {self.interference}"
            )

    @property
    def obstacle(self) -> RigidObstacle | None:
        """Side 2 if it is rigid."""
        return self.side2 if isinstance(self.side2, RigidObstacle) else None

    @property
    def surfaces(self) -> tuple[tuple[str, str], ...]:
        """Body and boundary of the sides that are surfaces of bodies."""
        return (self.side1,) if isinstance(self.side2, RigidObstacle) else (self.side1, self.side2)


@dataclass(frozen=True)
class Coupling:
    """Coupling of the n contact nodes of some interfaces in a configuration."""

    operator: csr_array  # (1) of a component, shape (n, nodes of the problem), m², in a plane m
    frame: np.ndarray  # rows n, t1, t2, shape (n, d, d)
    area: np.ndarray  # area of side 1 that is opposite side 2, shape (n,), m²
    transmits: np.ndarray  # of bool, components that transmit traction, not fixed, shape (n, d)

    @classmethod
    def stack(cls, couplings: Sequence["Coupling"], nodes: int, d: int) -> "Coupling":
        """Stack the interfaces of a problem with given numbers of nodes and dimensions."""
        return cls(
            csr_array(vstack([csr_array((0, nodes)), *(each.operator for each in couplings)])),
            np.concatenate([np.zeros((0, d, d)), *(each.frame for each in couplings)]),
            np.concatenate([np.zeros(0), *(each.area for each in couplings)]),
            np.concatenate([np.zeros((0, d), bool), *(each.transmits for each in couplings)]),
        )

    def __getitem__(self, rows: slice) -> "Coupling":
        return Coupling(
            self.operator[rows], self.frame[rows], self.area[rows], self.transmits[rows]
        )

    def slip_operator(self, old: "Coupling") -> csr_array:
        """Weighted slip (2) over positions: partners of the step before, current areas."""
        facing = old.area > 0.0
        share = np.where(facing, self.area / np.where(facing, old.area, 1.0), 0.0)
        return csr_array(
            diags_array(share) @ old.operator + diags_array(1.0 * ~facing) @ self.operator
        )


@dataclass(frozen=True)
class ContactInterface:
    """A contact with the numbers of its nodes in the whole problem."""

    name: str
    contact: Contact
    faces: tuple[OrientedFace, ...]  # side 1, and side 2 unless it is an obstacle
    nodes: tuple[np.ndarray, ...]  # their nodes, numbered over all bodies
    rows: slice  # among the contact nodes of the problem, which are the nodes of the sides 1
    area: np.ndarray  # undeformed area of each node of side 1, shape (n1,), m²
    free: np.ndarray  # components of side 1 without support, shape (n1, d)

    @property
    def follows(self) -> bool:
        """Whether side 2 is a body and the partners of its points change with the motion."""
        return self.contact.finite_sliding and self.contact.obstacle is None

    def couple(self, x: np.ndarray, time: float) -> Coupling:
        """Couple both sides at positions of all nodes, (nodes, d), m, and an obstacle at a time."""
        # normals, areas, and the operator (1)
        n1, d = len(self.nodes[0]), x.shape[1]
        side1, obstacle = x[self.nodes[0]], self.contact.obstacle
        if obstacle is not None:
            shift = obstacle.moved(d, time) if self.contact.finite_sliding else np.zeros(d)
            normal = -obstacle.distance(side1 - shift)[1]
            area = self.area  # the reaction is a force per undeformed area
            operator = csr_array((-area, (np.arange(n1), self.nodes[0])), shape=(n1, len(x)))
        else:
            normal = nodal_normals(self.faces[0], side1, self.free)
            facets, numbers = (self.faces[0].facets, self.faces[1].facets), self.nodes
            D, M = mortar_rows(
                facets,
                (side1, x[numbers[1]]),
                columns=(numbers[0][facets[0]], numbers[1][facets[1]]),
                sizes=(len(x), len(x)),
            )
            area, operator = np.asarray(D.sum(axis=1)), csr_array(M - D)  # (1)
        # frames, and components that can transmit traction
        frame = tangent_frames(normal)
        free = np.sqrt(np.sum((frame * self.free[:, None, :]) ** 2, axis=2)) >= LOCKED
        transmits = free & (area > LEAST_AREA * self.area)[:, None]
        return Coupling(operator, frame, area, transmits)

    def obstacle_gap(
        self, start: np.ndarray, motion: np.ndarray, normal: np.ndarray, shift: np.ndarray
    ) -> np.ndarray:
        """Gap of nodes to an obstacle, shape (n1,), m, from their motion and its shift, m."""
        distance = cast(RigidObstacle, self.contact.obstacle).distance
        if self.contact.finite_sliding:
            return distance(start + motion - shift)[0]
        closing = np.einsum("ai,ai->a", normal, shift - motion)
        return np.asarray(distance(start)[0] + closing)

    def fitted_gap(self, gap: np.ndarray, area: np.ndarray, start: np.ndarray) -> np.ndarray:
        """Gap at the start, m, that is subtracted if the faces fit; refuses bodies that overlap."""
        if self.contact.fitted:
            return gap + self.contact.interference
        facing = area > LEAST_AREA * self.area
        if self.contact.obstacle is None and np.any(gap[facing] < 0.0):
            sagitta = self._sagitta(start)
            typical = float(np.median(np.abs(gap[facing])))
            if typical < FACETED * sagitta:
                raise CaseError(
                    f"contact {self.name!r}: the bodies overlap at the start, with gaps of about "
                    f"{typical:.2g} m, below the error of the facets of both curved meshes: they "
                    f"do not match and miss the surface by {sagitta:.2g} m; give fitted=True and "
                    f"the interference, or meshes that match on the face"
                )
        return np.zeros_like(gap)

    def _sagitta(self, start: np.ndarray) -> float:
        r"""Median distance of facets to their arcs, :math:`L \theta / 8`, m; 0 if faces match."""
        from scipy.spatial import cKDTree

        x = [start[nodes] for nodes in self.nodes]
        apart = cKDTree(x[1]).query(x[0])[0]
        sagittas, lengths = [], []
        for face, at in zip(self.faces, x, strict=True):
            normal, node = nodal_normals(face, at, np.ones_like(at, dtype=bool)), np.zeros(len(at))
            first, last = face.facets, np.roll(face.facets, -1, axis=1)
            length = np.linalg.norm(at[last] - at[first], axis=2)
            miss = length * np.linalg.norm(normal[last] - normal[first], axis=2) / 8.0
            np.maximum.at(node, first, miss)
            np.maximum.at(node, last, miss)
            sagittas.append(float(np.median(node)))
            lengths.append(float(np.median(length)))
        return max(sagittas) if np.median(apart) > ASIDE * min(lengths) else 0.0

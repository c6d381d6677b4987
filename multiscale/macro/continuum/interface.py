r"""Two surfaces that may touch: coupling, frames, gap and slip.

Side 1 is a surface of a body and carries the reaction; side 2 is a surface of another body or a
rigid obstacle. With the matrices of :mod:`~multiscale.fe.mortar` the weighted jump
of a nodal field is

.. math:: B u = M u_2 - D u_1 ,    \tag{1}

in the frame :math:`(n, t_1, t_2)` of each node of side 1, with the normal from side 1 to side 2.
An obstacle takes part node by node: D holds the areas of the nodes and M is empty.

Where partners follow the motion, the slip of a step is how far the points that faced each other
at its start lie apart at its end,

.. math:: s = t \cdot (\bar B^- - \bar B)\, x ,    \tag{2}

with :math:`\bar B` over the area of the node: the difference of the mortar operators [1]_. A
rigid motion of both bodies keeps the operators, so that (2) is then zero, which
:math:`t \cdot \bar B (x - x^-)` is not where gaps or facets turn. Both agree to first order.

References
----------
.. [1] M. A. Puso and T. A. Laursen, Comput. Methods Appl. Mech. Eng. 193 (2004) 4891-4913,
   doi:10.1016/j.cma.2004.06.001: mortar contact with friction at large deformation.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array, diags_array

from multiscale.errors import CaseError
from multiscale.fe.facets import ContactFace, nodal_normals
from multiscale.fe.mortar import couple
from multiscale.macro.continuum.rigid_obstacle import RigidObstacle, obstacle_motion

__all__ = [
    "Contact",
    "ContactInterface",
    "Coupling",
    "build_coupling",
    "fit",
    "local_jump",
    "slip_operator",
]

FACETED = 10.0
"""Least ratio of an overlap to the distance by which facets miss their curved surface."""

ASIDE = 0.02
"""Distance of the nodes of both sides, relative to an edge, up to which their facets match."""

LEAST_AREA = 1e-9
"""Nodes with less than this share of their area opposite side 2 carry nothing."""


@dataclass(frozen=True)
class Contact:
    r"""Two surfaces that may touch.

    Parameters
    ----------
    side1 : tuple of str
        Body and boundary that carry the contact traction. The finer mesh belongs here.
    side2 : tuple of str or RigidObstacle
    friction_coefficient : float, default 0.0, Coulomb's :math:`\mu \ge 0`, dimensionless
    finite_sliding : bool, default False
        Whether partners and normals follow the motion. Otherwise they stay as at the start.
    reach : float, default inf, surfaces farther apart than this do not see each other, m
    fitted : bool, default False
        Whether the bodies fit at the start. The gap that the facets of two curved meshes show
        there is then an error of the meshes and is taken off.
    interference : float, default 0.0
        Normal distance by which fitted bodies overlap everywhere at the start, whatever their
        facets, as in a press fit, m.

    Raises
    ------
    CaseError
        If the coefficient is negative or not finite, the reach is not positive, or there is a
        negative interference or one of bodies that are not fitted.
    """

    side1: tuple[str, str]
    side2: tuple[str, str] | RigidObstacle
    friction_coefficient: float = 0.0
    finite_sliding: bool = False
    reach: float = np.inf
    fitted: bool = False
    interference: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.friction_coefficient < np.inf:
            raise CaseError(
                f"friction_coefficient must not be negative, got {self.friction_coefficient}"
            )
        if not self.reach > 0.0:
            raise CaseError(f"the reach of a contact must be positive (m), got {self.reach}")
        if not 0.0 <= self.interference < np.inf or (self.interference and not self.fitted):
            raise CaseError(
                f"the interference of a contact must not be negative (m) and takes fitted=True, "
                f"got {self.interference}"
            )

    @property
    def obstacle(self) -> RigidObstacle | None:
        """Side 2 if it is rigid."""
        return self.side2 if isinstance(self.side2, RigidObstacle) else None

    @property
    def surfaces(self) -> tuple[tuple[str, str], ...]:
        """Sides that are surfaces of bodies: body and boundary."""
        return (self.side1,) if isinstance(self.side2, RigidObstacle) else (self.side1, self.side2)


@dataclass(frozen=True)
class ContactInterface:
    """A contact with the numbers of its nodes in the whole problem.

    Attributes
    ----------
    name : str, of the contact
    contact : Contact, what the user gave
    surfaces : tuple of ContactFace, side 1, and side 2 unless it is an obstacle
    nodes : tuple of ndarray, their nodes, numbered over all bodies
    area : ndarray, shape (n1,), area that each node of side 1 stands for, undeformed, m²
    free : ndarray of bool, shape (n1, d), components of side 1 that no support holds
    offset : ndarray, shape (n1,), gap that is taken off, m
    """

    name: str
    contact: Contact
    surfaces: tuple[ContactFace, ...]
    nodes: tuple[np.ndarray, ...]
    area: np.ndarray
    free: np.ndarray
    offset: np.ndarray

    @property
    def follows(self) -> bool:
        """Whether side 2 is a body whose points are partners as the motion has it."""
        return self.contact.finite_sliding and self.contact.obstacle is None


@dataclass(frozen=True)
class Coupling:
    """An interface in one configuration.

    Attributes
    ----------
    operator : csr_array, shape (n1, nodes of the problem)
        (1) for one component, m² (m in two dimensions).
    frame : ndarray, shape (n1, d, d), rows n, t1, t2
    area : ndarray, shape (n1,), area of side 1 that is opposite side 2, m²
    kept : ndarray of bool, shape (n1, d)
        Local components that can be transmitted: not those that a support holds.
    """

    operator: csr_array
    frame: np.ndarray
    area: np.ndarray
    kept: np.ndarray


def build_coupling(interface: ContactInterface, x: np.ndarray, shift: np.ndarray) -> Coupling:
    """Couple the two sides where they are."""
    surface, nodes = interface.surfaces[0], interface.nodes[0]
    own = x[nodes]
    n1 = len(nodes)
    obstacle = interface.contact.obstacle
    if obstacle is not None:
        normal = -obstacle.distance(own - shift)[1]
        area = interface.area  # of the undeformed body: the reaction is then a force per that area
        operator = csr_array((-area, (np.arange(n1), nodes)), shape=(n1, len(x)))
    else:
        normal = nodal_normals(surface, own, interface.free)
        partner = x[interface.nodes[1]]
        facets = (surface.facets, interface.surfaces[1].facets)
        D, M = couple(facets, (own, partner), interface.contact.reach)
        area = np.asarray(D.sum(axis=1)).ravel()
        one, two = D.tocoo(), M.tocoo()
        rows = np.concatenate([one.row, two.row])
        columns = np.concatenate([nodes[one.col], interface.nodes[1][two.col]])
        operator = csr_array(
            (np.concatenate([-one.data, two.data]), (rows, columns)), shape=(n1, len(x))
        )
    frame = _frame(normal)
    held = np.sqrt(np.sum((frame * interface.free[:, None, :]) ** 2, axis=2)) < 0.1
    kept = ~held & (area > LEAST_AREA * interface.area)[:, None]
    return Coupling(operator, frame, area, kept)


def fit(interface: ContactInterface, start: np.ndarray) -> ContactInterface:
    """Take the gap of the start off, where the user says that the surfaces fit."""
    contact = interface.contact
    if contact.obstacle is not None and not contact.fitted:
        return interface
    rest = np.zeros_like(start)
    coupling = build_coupling(interface, start, rest[0])
    gap = local_jump(interface, (coupling, coupling), start, (rest, rest), (0.0, 0.0))[:, 0]
    if contact.fitted:
        return replace(interface, offset=gap + contact.interference)
    facing = coupling.area > LEAST_AREA * interface.area
    if not np.any(gap[facing] < 0.0):
        return interface
    sagitta = _sagitta(interface, start)
    typical = float(np.median(np.abs(gap[facing])))
    if typical < FACETED * sagitta:
        raise CaseError(
            f"contact {interface.name!r}: the bodies overlap at the start, with gaps of about "
            f"{typical:.2g} m, which the facets of both curved meshes hide: they do not match and "
            f"miss the surface by {sagitta:.2g} m; give fitted=True and the interference, or "
            f"meshes that match on the face"
        )
    return interface


def _sagitta(interface: ContactInterface, start: np.ndarray) -> float:
    r"""Distance of the facets of curved faces that do not match from their surface, m.

    An edge of the length L between normals that differ by :math:`\theta` misses its arc by
    :math:`L \theta / 8`; this is the median over the nodes of the larger side.
    """
    from scipy.spatial import cKDTree

    x = [start[nodes] for nodes in interface.nodes]
    apart = cKDTree(x[1]).query(x[0])[0]
    found, lengths = [], []
    for surface, at in zip(interface.surfaces, x, strict=True):
        normal, node = nodal_normals(surface, at, np.ones_like(at, dtype=bool)), np.zeros(len(at))
        first, last = surface.facets, np.roll(surface.facets, -1, axis=1)
        length = np.linalg.norm(at[last] - at[first], axis=2)
        miss = length * np.linalg.norm(normal[last] - normal[first], axis=2) / 8.0
        np.maximum.at(node, first, miss)
        np.maximum.at(node, last, miss)
        found.append(float(np.median(node)))
        lengths.append(float(np.median(length)))
    return max(found) if np.median(apart) > ASIDE * min(lengths) else 0.0


def local_jump(
    interface: ContactInterface,
    couplings: tuple[Coupling, Coupling],
    start: np.ndarray,
    motion: tuple[np.ndarray, np.ndarray],
    times: tuple[float, float],
) -> np.ndarray:
    """Gap and slip of a step, means over the area of each node, shape (n1, d), m."""
    before, now = motion
    old, coupling = couplings
    obstacle, offset = interface.contact.obstacle, interface.offset
    if obstacle is not None:
        nodes = interface.nodes[0]
        d = start.shape[1]
        last, shift = (obstacle_motion(obstacle, d, time) for time in times)
        slip = (shift - last) - (now - before)[nodes]
        jump = np.einsum("aki,ai->ak", coupling.frame, slip)
        if interface.contact.finite_sliding:
            jump[:, 0] = obstacle.distance(start[nodes] + now[nodes] - shift)[0] - offset
        else:
            closing = np.einsum("ai,ai->a", coupling.frame[:, 0], shift - now[nodes])
            jump[:, 0] = obstacle.distance(start[nodes])[0] + closing - offset
        return np.asarray(jump)
    area = np.where(coupling.area > 0.0, coupling.area, 1.0)[:, None]
    distance = coupling.operator @ (start + now) / area
    slip = coupling.operator @ (now - before) / area
    if interface.follows:
        facing = old.area > 0.0  # (2); a node that had no partner has no other slip than this
        slip[facing] = (slip_operator(old, coupling) @ (start + now) / area - distance)[facing]
    jump = np.einsum("aki,ai->ak", coupling.frame, slip)
    jump[:, 0] = np.einsum("ai,ai->a", coupling.frame[:, 0], distance) - offset
    return np.asarray(jump)


def slip_operator(old: Coupling, coupling: Coupling) -> csr_array:
    """Weighted slip (2) over positions: partners of the step before, areas of now, shape as B."""
    facing = old.area > 0.0
    share = np.where(facing, coupling.area / np.where(facing, old.area, 1.0), 0.0)
    return csr_array(
        diags_array(share) @ old.operator + diags_array(1.0 * ~facing) @ coupling.operator
    )


def _frame(normal: np.ndarray) -> np.ndarray:
    """Complete normals by tangents: t1 is the x axis in the tangent plane (y if n is near x)."""
    n, d = normal.shape
    axis = np.zeros((n, d))
    steep = np.abs(normal[:, 0]) > 0.9
    axis[~steep, 0] = 1.0
    axis[steep, 1] = 1.0
    t1 = axis - np.sum(axis * normal, axis=1, keepdims=True) * normal
    t1 /= np.linalg.norm(t1, axis=1, keepdims=True)
    axes = [normal, t1] if d == 2 else [normal, t1, np.cross(normal, t1)]
    return np.asarray(np.stack(axes, axis=1))

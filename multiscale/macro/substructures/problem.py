"""Substructures, interfaces, and the problem of a cut structure."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array, csr_array, diags_array, eye_array, vstack
from scipy.sparse.csgraph import connected_components

from multiscale.errors import CaseError
from multiscale.fe.elasticity import rigid_motions
from multiscale.laws.interface_law import InterfaceLaw, SideBySide, lay_side_by_side
from multiscale.numerics.factorisation import compact, factorise, on_diagonal


@dataclass(frozen=True, eq=False)
class Links:
    r"""Non-smooth links inside a substructure, eqs (14) and (15) of the source.

    .. math:: \tau = P(\tau^0 + k B u)    \tag{1}

    Attributes
    ----------
    operator : csr_array, shape (rows, n), compatibility :math:`B`
    stiffness, prestress, lower, upper : ndarray, shape (rows,)
        :math:`k` (N/m), :math:`\tau^0` and the admissible range (N) of the projection :math:`P`.
    number : ndarray of int, shape (rows,), number of every link in the whole structure
    """

    operator: csr_array
    stiffness: np.ndarray
    prestress: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    number: np.ndarray


@dataclass(frozen=True, eq=False)
class Substructure:
    r"""Substructure: :math:`K u + B^T \tau = f` and forces from its neighbours.

    Attributes
    ----------
    stiffness : csr_array, shape (n, n)
        Stiffness of its linear elements, N/m, supports eliminated. It may be singular.
    load : ndarray, shape (n, cases), external forces, a column for each load case, N
    unknown : ndarray of int, shape (n,)
        Number of every unknown in the whole structure. Unknowns of several substructures make a
        perfect interface.
    position : ndarray, shape (n, 3), position of the node of every unknown, m
    component : ndarray of int, shape (n,)
        Direction of every unknown: 0, 1 or 2; 3, 4, 5 for rotations times a length.
    links : Links, optional, its non-smooth elements
    """

    stiffness: csr_array
    load: np.ndarray
    unknown: np.ndarray
    position: np.ndarray
    component: np.ndarray
    links: Links | None = None

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.unknown.size

    @property
    def n_links(self) -> int:
        """Number of links."""
        return self.links.number.size if self.links else 0

    @cached_property
    def rigid_motions(self) -> np.ndarray:
        """Displacement of every unknown in three translations and three rotations, (n, 6)."""
        return rigid_motions(self.position, self.component)


@dataclass(frozen=True, eq=False)
class CutInterface:
    r"""Interface of substructures.

    Attributes
    ----------
    sides : tuple of int
        The substructures. A law joins two, a perfect interface two or more.
    trace : tuple of csr_array, shape (m, n)
        Displacement of every side; with a law m is three times the number of points: normal
        first, then both tangents, and the jump is side 2 minus side 1, opening positive.
    law : InterfaceLaw, optional; without a law perfect, (16) and (17) of the source
    weight : ndarray, shape (points,), quadrature weights of the points of a law, m²
    position : ndarray, shape (points, 3), position of these points, m
    joint : int, number of the joint, several interfaces of which may have been cut
    gap : ndarray, shape (points,), initial gaps in addition to the gap of the law, m, optional
    """

    sides: tuple[int, ...]
    trace: tuple[csr_array, ...]
    law: InterfaceLaw | None = None
    weight: np.ndarray = field(default_factory=lambda: np.zeros(0))
    position: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    joint: int = 0
    gap: np.ndarray | None = None

    @property
    def size(self) -> int:
        """Number of unknowns of a side."""
        return int(self.trace[0].shape[0])


@dataclass(frozen=True, eq=False)
class CutBolt:
    """A bolt between the centres of its washers."""

    unknown: tuple[int, int]  # of the lower and the upper washer along the axis
    stiffness: float  # of the shank, N/m
    preload: float  # force at the factor 1 of the first load case, N
    name: str  # in messages

    def pull(self, n: int) -> np.ndarray:
        """Return the forces on all unknowns, shape (n,), of a unit tension of the bolt."""
        pull = np.zeros(n)
        pull[list(self.unknown)] = 1.0, -1.0
        return pull


@dataclass(frozen=True, eq=False)
class CutProblem:
    """A structure that has been cut.

    Attributes
    ----------
    position : ndarray, shape (nodes, 3), m
    expansion : csr_array, shape (nodes * c, n)
        Components of the displacement of the nodes from the unknowns: rows are empty where a
        component is fixed, and have an entry where it is an unknown, more where a rigid plate
        moves it.
    joints : tuple of CutInterface
        Interfaces with a law. Perfect interfaces follow from the numbers of the unknowns.
    bolts : tuple of CutBolt, tightened by the first load case
    locked : bool, whether the last substructures are the shanks of the bolts

    Raises
    ------
    CaseError
        If the traces of an interface do not fit its sides.
    """

    substructures: tuple[Substructure, ...]
    position: np.ndarray
    expansion: csr_array
    joints: tuple[CutInterface, ...] = ()
    bolts: tuple[CutBolt, ...] = ()
    locked: bool = False

    def __post_init__(self) -> None:
        for place, joint in enumerate(self.joints):
            _check_joint(place, joint, self.substructures)

    @cached_property
    def interfaces(self) -> tuple[CutInterface, ...]:
        """Perfect interfaces, then interfaces with a law."""
        return (*_perfect_interfaces(self.substructures), *self.joints)

    @cached_property
    def sides(self) -> list[list[tuple[int, int]]]:
        """Interfaces of every substructure, by their numbers, and its side of each."""
        sides: list[list[tuple[int, int]]] = [[] for _ in self.substructures]
        for number, face in enumerate(self.interfaces):
            for side, owner in enumerate(face.sides):
                sides[owner].append((number, side))
        return sides

    @cached_property
    def points(self) -> list[slice]:
        """Points of every joint, among the points of all."""
        ends = np.cumsum([0, *(joint.weight.size for joint in self.joints)])
        return [slice(a, b) for a, b in pairwise(ends.tolist())]

    @cached_property
    def law(self) -> SideBySide:
        """Laws of all joints side by side."""
        laws = [joint.law for joint in self.joints if joint.law]
        return lay_side_by_side(laws, (joint.weight.size for joint in self.joints), self.gap)

    @cached_property
    def weight(self) -> np.ndarray:
        """Area of the points of all joints, m², shape (points,)."""
        return np.concatenate([np.zeros(0), *(joint.weight for joint in self.joints)])

    @cached_property
    def gap(self) -> np.ndarray:
        """Initial gap of the points of all joints in addition to the gaps of their laws, m."""
        gap = np.zeros(self.weight.size)
        for joint, at in zip(self.joints, self.points, strict=True):
            gap[at] = 0.0 if joint.gap is None else joint.gap
        return gap

    @property
    def point_joint(self) -> np.ndarray:
        """Joint of every point, by its number, shape (points,)."""
        numbers = [np.full(joint.weight.size, joint.joint) for joint in self.joints]
        return np.concatenate([np.zeros(0, dtype=int), *numbers])

    def with_laws(self, laws: Sequence[InterfaceLaw]) -> "CutProblem":
        """Return the same structure with other laws of its joints, by their numbers."""
        joints = tuple(replace(joint, law=laws[joint.joint]) for joint in self.joints)
        return replace(self, joints=joints)

    def with_loads(self, load: np.ndarray) -> "CutProblem":
        """Return the same structure with further load cases at the end, shape (n, cases), N."""
        share = load / self.shares[:, None]
        substructures = tuple(
            replace(each, load=np.column_stack([each.load, share[each.unknown]]))
            for each in self.substructures
        )
        return replace(self, substructures=substructures)

    def with_stiffness(self, added: csr_array) -> "CutProblem":
        """Return the same structure with a further stiffness, which substructures share, N/m."""
        share = csr_array(diags_array(1.0 / self.shares) @ added)
        substructures = tuple(
            replace(
                each, stiffness=csr_array(each.stiffness + share[each.unknown][:, each.unknown])
            )
            for each in self.substructures
        )
        return replace(self, substructures=substructures)

    def with_locked_bolts(self) -> "CutProblem":
        """Return the structure with the shanks of its bolts as substructures.

        A load case for each bolt, a tension of 1 N in its washers, follows the other load cases.
        """
        if not self.bolts:
            return self
        position, component = self.places()
        pulls = np.stack([bolt.pull(self.n) for bolt in self.bolts], axis=1)
        substructures = list(self.with_loads(pulls).substructures)
        for bolt in self.bolts:
            ends = np.array(bolt.unknown)
            K = csr_array(bolt.stiffness * np.array([[1.0, -1.0], [-1.0, 1.0]]))
            load = np.zeros((2, self.n_cases + len(self.bolts)))
            substructures.append(Substructure(K, load, ends, position[ends], component[ends]))
        return replace(self, substructures=tuple(substructures), locked=True)

    @property
    def n(self) -> int:
        """Number of unknowns of the whole structure."""
        return int(self.expansion.shape[1])

    @property
    def n_cases(self) -> int:
        """Number of load cases."""
        return int(self.substructures[0].load.shape[1])

    def displacement(self, value: np.ndarray) -> np.ndarray:
        """Displacement of the nodes, shape (nodes, 3), from the unknowns, m."""
        return np.asarray((self.expansion @ value).reshape(len(self.position), -1)[:, :3])

    def unknowns(self, displacement: np.ndarray) -> np.ndarray:
        """Unknowns, shape (..., n), from the displacement of the nodes, (..., nodes, c), m."""
        E = self.expansion
        flat = displacement.reshape(-1, E.shape[0])
        value = factorise(csr_array(E.T @ E), name="the expansion")(E.T @ flat.T)
        return np.asarray(value.T.reshape(*displacement.shape[:-2], self.n))

    @cached_property
    def jump(self) -> csr_array:
        """Normal jumps of the points of all joints, then both tangential jumps, (3 points, n)."""
        jumps = []
        for joint in self.joints:
            first, second = (
                select(self.substructures[side].unknown, self.n, trace)
                for side, trace in zip(joint.sides, joint.trace, strict=True)
            )
            jumps.append(csr_array(second - first))
        parts = [
            jump[k * size : (k + 1) * size]
            for k in range(3)
            for jump, size in ((jump, jump.shape[0] // 3) for jump in jumps)
        ]
        return compact(csr_array(vstack([csr_array((0, self.n)), *parts])))

    @cached_property
    def numbers(self) -> np.ndarray:
        """Numbers of the unknowns of all substructures in turn."""
        return np.concatenate([substructure.unknown for substructure in self.substructures])

    def sum_up(self, values: Sequence[np.ndarray]) -> np.ndarray:
        """Sum over the substructures that share an unknown, shape (n,)."""
        return np.bincount(self.numbers, np.concatenate(values), minlength=self.n)

    @property
    def shares(self) -> np.ndarray:
        """Number of substructures that have an unknown, shape (n,)."""
        return self.sum_up([np.ones(self.numbers.size)])

    def average(self, value: np.ndarray) -> np.ndarray:
        """Mean over the substructures of values of all of them in turn, shape (n,)."""
        return np.asarray(self.sum_up([value]) / np.maximum(self.shares, 1.0))

    @property
    def placement(self) -> csr_array:
        """Unknowns of all substructures in turn from the unknowns of the structure, (N, n)."""
        return select(self.numbers, self.n)

    def load(self, factor: np.ndarray) -> np.ndarray:
        """Return the forces on the structure at factors of the load cases, N, shape (n,)."""
        return self.sum_up([substructure.load @ factor for substructure in self.substructures])

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Position, (n, 3), m, and component, (n,), of the unknowns."""
        position, component = np.zeros((self.n, 3)), np.zeros(self.n, dtype=int)
        for each in self.substructures:
            position[each.unknown], component[each.unknown] = each.position, each.component
        return position, component

    @cached_property
    def bodies(self) -> np.ndarray:
        """Body of every substructure but shanks; substructures of a body share unknowns."""
        shanks = len(self.bolts) if self.locked else 0
        cut = self.substructures[: len(self.substructures) - shanks]
        numbers = np.concatenate([substructure.unknown for substructure in cut])
        owner = np.repeat(np.arange(len(cut)), [substructure.n for substructure in cut])
        shared = coo_array((np.ones(owner.size), (owner, numbers)), shape=(len(cut), self.n))
        return np.asarray(connected_components(shared @ shared.T, directed=False)[1])

    @cached_property
    def motions(self) -> np.ndarray:
        """Rigid motions of all bodies, each about its centre, shape (n, 6 bodies), m."""
        position, component = self.places()
        bodies = self.bodies
        motions = np.zeros((self.n, 6 * (1 + bodies.max())))
        for body in np.unique(bodies):
            owners = np.flatnonzero(bodies == body)
            unknown = np.unique(np.concatenate([self.substructures[at].unknown for at in owners]))
            moved = rigid_motions(position[unknown], component[unknown])
            size = np.abs(moved).max(axis=0, initial=0.0)
            motions[unknown, 6 * body : 6 * body + 6] = moved / np.where(size > 0.0, size, 1.0)
        return motions

    def link_fields(self, tension: np.ndarray, slack: np.ndarray) -> dict[str, np.ndarray]:
        """Sort tension, N, and slack, m, of the substructures in turn by the number of the link."""
        if not self.n_links:
            return {}
        place = np.argsort(
            np.concatenate([each.links.number for each in self.substructures if each.links])
        )
        return {"tension": tension[place], "slack": slack[place]}

    @property
    def n_links(self) -> int:
        """Number of links."""
        return sum(each.n_links for each in self.substructures)


def select(unknown: np.ndarray, n: int, operator: csr_array | None = None) -> csr_array:
    """Extend an operator on some of the n unknowns, by default their selection, to all."""
    if operator is None:
        operator = eye_array(unknown.size, format="csr")
    entries = operator.data, unknown[operator.indices], operator.indptr
    return compact(csr_array(entries, shape=(operator.shape[0], n)))


def join_links(substructures: Sequence[Substructure]) -> Links:
    """Links of substructures in turn, with a block-diagonal operator."""
    none = np.zeros(0)
    links = [
        each.links or Links(csr_array((0, each.n)), none, none, none, none, none.astype(int))
        for each in substructures
    ]
    names = ("stiffness", "prestress", "lower", "upper", "number")
    arrays = (np.concatenate([getattr(item, name) for item in links]) for name in names)
    return Links(on_diagonal(item.operator for item in links), *arrays)


def expand_numbers(number: np.ndarray) -> csr_array:
    """Expansion of nodes; each component is an unknown or, at a negative number, fixed."""
    row = np.flatnonzero(number.ravel() >= 0)
    shape = (number.size, 1 + int(number.max(initial=-1)))
    return csr_array((np.ones(row.size), (row, number.ravel()[row])), shape=shape)


def _perfect_interfaces(substructures: Sequence[Substructure]) -> list[CutInterface]:
    """Group the shared unknowns by the substructures that share them."""
    numbers = np.concatenate([substructure.unknown for substructure in substructures])
    sizes = [substructure.n for substructure in substructures]
    owner = np.repeat(np.arange(len(sizes)), sizes)
    local = np.concatenate([np.arange(size) for size in sizes])

    # entries of the same number follow each other, in the order of their substructures
    order = np.lexsort((owner, numbers))
    start = np.flatnonzero(np.append(True, np.diff(numbers[order]) != 0))
    classes: dict[tuple[int, ...], list[np.ndarray]] = {}
    for first, last in zip(start, np.append(start[1:], order.size), strict=True):
        if last - first > 1:
            entries = order[first:last]
            classes.setdefault(tuple(owner[entries].tolist()), []).append(local[entries])

    # a trace picks the unknowns of a side
    faces = []
    for sides, shared in classes.items():
        pick = np.ones(len(shared)), np.arange(len(shared))
        traces = [
            csr_array((pick[0], (pick[1], rows)), shape=(len(shared), sizes[side]))
            for side, rows in zip(sides, np.array(shared).T, strict=True)
        ]
        faces.append(CutInterface(sides, tuple(traces)))
    return faces


def _check_joint(place: int, joint: CutInterface, substructures: Sequence[Substructure]) -> None:
    if len(joint.sides) != 2 or len(joint.trace) != 2:
        raise CaseError(f"interface {place} has a law and must have two sides, got {joint.sides}")
    for side, trace in zip(joint.sides, joint.trace, strict=True):
        expected = (3 * joint.weight.size, substructures[side].n)
        if trace.shape != expected:
            raise CaseError(
                f"interface {place} does not match substructure {side}: its trace must have shape "
                f"{expected} (three per point, unknowns), got {trace.shape}"
            )

"""Structure of nodes and links, and checks of its data."""

from dataclasses import dataclass, field
from functools import cached_property
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from multiscale.errors import CaseError
from multiscale.fe.elasticity import count_free_motions
from multiscale.laws.link import Beam, LinkLaw
from multiscale.needs import Choice, Needs
from multiscale.schema import MACRO_RESULT, Dataset

BALANCE_TOLERANCE = 1e-6  # largest allowed residual force, relative to the largest prestress

MIN_RELATIVE_LENGTH = 1e-9
"""Smallest allowed length of a link, relative to the size of the structure."""

LINK_MEMORY, UNKNOWN_MEMORY = (2000, 200), (600, 100)
"""Peak memory per link and per unknown, byte: for operators and factors, and for the results of
each step. Measured on grids and nets of 16,000 to 147,000 links."""

SUPERLU_MEMORY = 7000
"""Additional memory per unknown of a grid, byte, if SuperLU factorises, without pypardiso."""

STEP_TIME = 8e-5  # time of an unknown in a step, s, on a grid of 9,400 unknowns


@dataclass(frozen=True, eq=False)
class LinkSystem:
    r"""Discrete structure in its prestressed configuration :math:`\Omega_0`.

    Parameters
    ----------
    position : ndarray, shape (nodes, 3), positions of the nodes, m
    ends : ndarray of int, shape (links, 2), nodes at both ends of every link
    kind : ndarray of int, shape (links,), index of the law of each link
    fixed : ndarray of bool, shape (nodes, c)
        Fixed unknowns. With c = 3 displacements along x, y, z; with beams c = 6, the rotations
        about x, y, z follow.
    load : ndarray, shape (nodes, c), forces (N) and with beams moments (N m) at load factor 1
    prestress : ndarray, shape (links,), optional
        Tension :math:`\tau^0`, N, compression negative; zero if not given.
    group : ndarray of int, shape (links,), optional
        Module of each link. Modules with a common edge have parallel links there; within a module
        a second link between the same nodes is refused as a duplicate.
    balanced : bool
        Whether the prestress must be in equilibrium at every free node. Without equilibrium,
        :math:`\Omega_0` is only the reference of the relaxed lengths, and the structure moves at
        load factor 0, for example after a cable has been cut.

    Raises
    ------
    CaseError
        If shapes or numbers do not fit, a node belongs to no link, a link has no length or occurs
        twice, or the prestress is not in equilibrium.

    Examples
    --------
    Two bars carry 1 kN at their common node:

    >>> from multiscale.laws.link import Bar
    >>> from multiscale.macro import solve_static
    >>> two_bars = LinkSystem(
    ...     position=np.array([[-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 0.0, 0.0]]),
    ...     ends=np.array([[0, 2], [1, 2]]),
    ...     laws=(Bar(rigidity=1e7),),
    ...     kind=np.array([0, 0]),
    ...     fixed=np.array([[True, True, True], [True, True, True], [False, True, False]]),
    ...     load=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, -1000.0]]),
    ... )
    >>> solve_static(two_bars).tension.values.round(3)
    array([707.107, 707.107])
    """

    position: np.ndarray
    ends: np.ndarray
    laws: tuple[LinkLaw, ...]
    kind: np.ndarray
    fixed: np.ndarray
    load: np.ndarray
    prestress: np.ndarray = field(default_factory=lambda: np.zeros(0))
    group: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    balanced: bool = True

    def __post_init__(self) -> None:
        for name, kind in (("prestress", float), ("group", int)):
            if not np.size(getattr(self, name)):
                object.__setattr__(self, name, np.zeros(len(self.ends), dtype=kind))
        _check_nodes(self)
        _check_links(self)
        _check_graph(self)
        if self.balanced:
            _check_balance(self)

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.position)

    @property
    def n_links(self) -> int:
        """Number of links."""
        return len(self.ends)

    @property
    def n_components(self) -> int:
        """Number of unknowns per node: 3, or 6 with beams."""
        return 6 if any(isinstance(law, Beam) for law in self.laws) else 3

    @cached_property
    def span(self) -> np.ndarray:
        """Vector from the first to the second end, shape (links, 3), m."""
        return np.asarray(self.position[self.ends[:, 1]] - self.position[self.ends[:, 0]])

    @cached_property
    def length(self) -> np.ndarray:
        """Distance of the ends, shape (links,), m."""
        return np.asarray(np.sqrt(np.einsum("li,li->l", self.span, self.span)))

    @cached_property
    def direction(self) -> np.ndarray:
        """Unit vector from the first to the second end, shape (links, 3)."""
        return np.asarray(self.span / self.length[:, None])

    @cached_property
    def stiffness(self) -> np.ndarray:
        """Axial stiffness EA/L, shape (links,), N/m; infinite for links of fixed length."""
        return np.asarray(np.array([law.rigidity for law in self.laws])[self.kind] / self.length)

    @cached_property
    def bounds(self) -> np.ndarray:
        """Lowest and highest admissible tension, shape (2, links), N."""
        return np.array([[law.lower, law.upper] for law in self.laws]).T[:, self.kind]


def nodal_pull(system: LinkSystem, pull: np.ndarray) -> np.ndarray:
    """Sum pulls of the links, shape (links, 3), N, at their second ends less the first ends."""
    force = np.zeros((system.n_nodes, 3))
    for i in range(3):
        force[:, i] = np.bincount(system.ends[:, 1], pull[:, i], system.n_nodes)
        force[:, i] -= np.bincount(system.ends[:, 0], pull[:, i], system.n_nodes)
    return force


def check_supports(system: LinkSystem) -> None:
    """Refuse a structure with a connected component that can move as a rigid body."""
    graph = coo_array(
        (np.ones(system.n_links, dtype=np.int8), tuple(system.ends.T)), (system.n_nodes,) * 2
    )
    count, component = connected_components(graph, directed=False)
    for k in range(count):
        inside = np.flatnonzero(component == k)
        freedom = count_free_motions(system.position[inside], np.asarray(system.fixed)[inside])
        if freedom:
            whole = "the structure" if count == 1 else f"the component with node {inside[0]}"
            raise CaseError(
                f"{whole} ({inside.size} nodes) is not supported: {freedom} of its rigid motions "
                f"are free; fix more directions of its nodes"
            )


def describe(system: LinkSystem) -> dict[str, Any]:
    """Return position, ends and law of ``MACRO_RESULT``, from which the structure is drawn."""
    names = np.array([type(law).__name__.lower() for law in system.laws])
    return {"position": system.position, "ends": system.ends, "law": names[system.kind]}


def link_dataset(system: LinkSystem, values: dict[str, Any], **labels: Any) -> Dataset:
    """Return variables of steps as a dataset that follows ``MACRO_RESULT``, with the structure."""
    import xarray as xr

    labels |= {"link": range(system.n_links), "node": range(system.n_nodes)}
    result = MACRO_RESULT.assign(xr.Dataset(), values | describe(system))
    result = result.assign_coords(component=["x", "y", "z"], **labels)
    MACRO_RESULT.check(result)
    return result


def link_needs(
    system: LinkSystem,
    *,
    exact: bool = False,
    stability: bool = False,
    moving: bool = False,
    steps: int = 1,
) -> Needs:
    """Return the unknowns, operators and memory of an analysis of links."""
    links, unknowns = system.n_links, int((~np.asarray(system.fixed, dtype=bool)).sum())
    rigid = bool(np.isinf(system.stiffness).any())
    one_sided = bool(np.isfinite(system.bounds).any())
    choices = (
        Choice("tangent", "stiffness of the taut links"),
        Choice("slack", "cables without compression, struts without tension", one_sided),
        Choice("moved positions", "lengths and directions at the displaced nodes", exact),
        Choice("geometric stiffness", "of the tensions, for the tangent", exact or stability),
        Choice("eigenvalues", "the smallest of the tangent, for stability", stability),
        Choice("beam modes", "bending and twist, with nodal rotations", system.n_components == 6),
        Choice("mass", "of the nodes, in the matrix of every step", moving),
        Choice("impulses", "velocity jumps at links of fixed length", moving and rigid),
    )
    factors = 0 if find_spec("pypardiso") else SUPERLU_MEMORY
    link_memory, unknown_memory = (
        once + steps * each for once, each in (LINK_MEMORY, UNKNOWN_MEMORY)
    )
    return Needs(
        unknowns_per_contact=1,
        kinematics="large displacements" if exact else "small displacements",
        choices=choices,
        state_variables=("displacement", "velocity", "tension") if moving else (),
        fields=("tension", "slack", "displacement"),
        libraries=("numba",),
        seconds=STEP_TIME * unknowns * steps,
        memory=links * link_memory + unknowns * (unknown_memory + factors),
    )


def _check_nodes(system: LinkSystem) -> None:
    nodes, c = system.n_nodes, system.n_components
    expected = {"position": (nodes, 3), "fixed": (nodes, c), "load": (nodes, c)}
    for name, shape in expected.items():
        given = np.shape(getattr(system, name))
        if given != shape:
            why = " (six unknowns per node with beams)" if c == 6 and name != "position" else ""
            raise CaseError(f"{name} must have shape {shape}{why}, got {given}")
    for name in ("position", "load"):
        finite = np.isfinite(getattr(system, name)).all(axis=1)
        if not finite.all():
            raise CaseError(f"{name} of node {int(np.argmin(finite))} is not finite")


def _check_links(system: LinkSystem) -> None:
    links = system.n_links
    if links == 0 or np.shape(system.ends) != (links, 2):
        raise CaseError(f"ends must have shape (links, 2), got {np.shape(system.ends)}")
    for name in ("kind", "prestress", "group"):
        shape = np.shape(getattr(system, name))
        if shape != (links,):
            raise CaseError(f"{name} must have an entry for each link, ({links},), got {shape}")
    for name, top in (("ends", system.n_nodes), ("kind", len(system.laws))):
        number = np.asarray(getattr(system, name))
        outside = np.flatnonzero(((number < 0) | (number >= top)).reshape(links, -1).any(axis=1))
        if outside.size:
            k = int(outside[0])
            raise CaseError(f"{name} of link {k} must lie between 0 and {top - 1}, got {number[k]}")
    finite = np.isfinite(system.prestress)
    if not finite.all():
        raise CaseError(f"prestress of link {int(np.argmin(finite))} is not finite")
    lower, upper = system.bounds
    outside = np.flatnonzero((system.prestress < lower) | (system.prestress > upper))
    if outside.size:
        k = int(outside[0])
        law = type(system.laws[system.kind[k]]).__name__.lower()
        raise CaseError(
            f"prestress of link {k}, a {law}, must lie between {lower[k]:g} and {upper[k]:g} N, "
            f"got {system.prestress[k]:g}"
        )


def _check_graph(system: LinkSystem) -> None:
    """Refuse nodes without links, links without length, and duplicates."""
    unlinked = np.setdiff1d(np.arange(system.n_nodes), system.ends)
    if unlinked.size:
        named = ", ".join(str(node) for node in unlinked[:5])
        more = f" and {unlinked.size - 5} more" if unlinked.size > 5 else ""
        subject = f"node {named} has" if unlinked.size == 1 else f"nodes {named}{more} have"
        raise CaseError(f"{subject} no link; connect or remove nodes without links")
    size = float(np.ptp(system.position, axis=0).max())
    shortest = int(np.argmin(system.length))
    if not system.length[shortest] > MIN_RELATIVE_LENGTH * size:
        a, b = system.ends[shortest]
        raise CaseError(
            f"link {shortest} between nodes {a} and {b} has length {system.length[shortest]:g} m; "
            f"merge the nodes or move them apart"
        )
    low, high = np.sort(system.ends, axis=1).T.astype(np.int64)
    key = (system.group.astype(np.int64) * system.n_nodes + low) * system.n_nodes + high
    order = np.argsort(key, kind="stable")
    twice = np.flatnonzero(np.diff(key[order]) == 0)
    if twice.size:
        first, second = order[twice[0]], order[twice[0] + 1]
        a, b = system.ends[first]
        raise CaseError(
            f"links {first} and {second} both join nodes {a} and {b}; remove a link, or give them "
            f"different groups if they belong to different modules"
        )


def _check_balance(system: LinkSystem) -> None:
    """Refuse a prestress that is not in equilibrium at the free components of the nodes."""
    largest = float(np.abs(system.prestress).max())
    if largest == 0.0:
        return
    force = nodal_pull(system, system.prestress[:, None] * system.direction)
    force[system.fixed[:, :3]] = 0.0
    force = np.sqrt(np.square(force).sum(axis=1))
    worst = int(np.argmax(force))
    if force[worst] > BALANCE_TOLERANCE * largest:
        bad = int(np.count_nonzero(force > BALANCE_TOLERANCE * largest))
        named = "1 node" if bad == 1 else f"{bad} nodes"
        raise CaseError(
            f"the prestress is not in equilibrium at {named}, worst at node {worst} by "
            f"{force[worst]:.4g} N ({100 * force[worst] / largest:.2g} % of its largest tension); "
            f"give a state of self-stress, for instance from self_stress"
        )

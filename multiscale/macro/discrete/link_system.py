"""Structures of nodes and links: trusses, frames, tensegrities and cable nets."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from multiscale.laws.link import Beam, LinkLaw
from multiscale.macro.discrete.checks import check_balance, check_links, check_nodes

__all__ = ["LinkSystem"]


@dataclass(frozen=True, eq=False)
class LinkSystem:
    r"""Discrete structure in its prestressed configuration :math:`\Omega_0`.

    Parameters
    ----------
    position : ndarray, shape (nodes, 3), positions of the nodes, m
    ends : ndarray of int, shape (links, 2), nodes at both ends of every link
    laws : tuple of LinkLaw
    kind : ndarray of int, shape (links,), index of the law of each link
    fixed : ndarray of bool, shape (nodes, c)
        Fixed unknowns. With c = 3 displacements along x, y, z; with beams c = 6, the rotations
        about x, y, z follow.
    load : ndarray, shape (nodes, c), forces (N) and with beams moments (N m) at load factor one
    prestress : ndarray, shape (links,), optional
        Tension :math:`\tau^0`, N, compression negative; zero if not given.
    group : ndarray of int, shape (links,), optional
        Module of each link. Modules with a common edge have parallel links there; within a module
        a second link between the same nodes is refused as a duplicate.
    balanced : bool
        Whether the prestress must be in equilibrium at every free node. If it is not,
        :math:`\Omega_0` is only the reference of the relaxed lengths, and the structure moves at
        load factor zero, for example after a cable has been cut.

    Raises
    ------
    CaseError
        If shapes or numbers do not fit, a node belongs to no link, a link has no length or occurs
        twice, or the prestress is out of balance.

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
        links = len(self.ends)
        for name, kind in (("prestress", float), ("group", int)):
            if not np.size(getattr(self, name)):
                object.__setattr__(self, name, np.zeros(links, dtype=kind))
        check_nodes(self)
        check_links(self)
        if self.balanced:
            check_balance(self)

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

"""Builders of a plane truss and of a cable net."""

import numpy as np

from multiscale.errors import CaseError
from multiscale.laws.link import Bar, Cable
from multiscale.macro.discrete.link_system import LinkSystem

__all__ = ["cable_net", "truss"]


def truss(
    panels: int,
    *,
    panel: float = 1.0,
    height: float = 1.0,
    bar: Bar | None = None,
    nodal_load: float = 1000.0,
) -> LinkSystem:
    """Simply supported plane Pratt truss with an even number of panels.

    Parameters
    ----------
    panels : int
    panel, height : float, length of a panel and distance of the chords, m
    bar : Bar, optional, law of the bars; rigidity 2.1e8 N if not given
    nodal_load : float
        Force on every inner node of the lower chord at load factor one, N, downwards.

    Returns
    -------
    LinkSystem
        Statically determinate truss in the plane y = 0. Nodes: lower chord, then upper chord,
        without nodes above the supports. Links: lower chord, upper chord, posts, diagonals that
        descend towards the middle, end bars.

    Raises
    ------
    CaseError
        If a number is out of range.
    """
    if panels < 2 or panels % 2:
        raise CaseError(f"a Pratt truss needs an even number of panels, got {panels}")
    _check_positive(panel=panel, height=height)
    inner, half = np.arange(1, panels), panels // 2
    upper = panels + inner  # upper node above lower node i is panels + i
    left, right = inner[inner < half], inner[inner > half]
    ends = np.concatenate(
        [
            np.stack([np.arange(panels), np.arange(1, panels + 1)], axis=1),
            np.stack([upper[:-1], upper[1:]], axis=1),
            np.stack([inner, upper], axis=1),
            np.stack([panels + left, left + 1], axis=1),
            np.stack([panels + right, right - 1], axis=1),
            np.array([[0, panels + 1], [panels, 2 * panels - 1]]),
        ]
    )
    position = np.zeros((2 * panels, 3))
    position[: panels + 1, 0] = panel * np.arange(panels + 1)
    position[panels + 1 :, 0] = panel * inner
    position[panels + 1 :, 2] = height
    fixed = np.zeros((2 * panels, 3), dtype=bool)
    fixed[:, 1] = True
    fixed[0] = True
    fixed[panels, 2] = True
    load = np.zeros((2 * panels, 3))
    load[1:panels, 2] = -nodal_load
    kind = np.zeros(len(ends), dtype=int)
    return LinkSystem(position, ends, (bar or Bar(2.1e8),), kind, fixed, load)


def cable_net(
    n: int,
    m: int | None = None,
    *,
    mesh: float = 1.0,
    rise: float = 1.0,
    prestress: float = 10e3,
    cable: Cable | None = None,
    nodal_load: float = 100.0,
) -> LinkSystem:
    r"""Prestressed saddle of n x m meshes, fixed along its edge.

    Parameters
    ----------
    n, m : int, number of meshes along x and y, at least two; m = n if not given
    mesh : float, distance of the cables in plan, m
    rise : float
        Height of the saddle :math:`z = r (\xi^2 - \eta^2)`, m, with :math:`\xi` and
        :math:`\eta` from -1 to 1.
    prestress : float, horizontal part of every tension at load factor zero, N
    cable : Cable, optional, law of the cables; rigidity 1e7 N if not given
    nodal_load : float, vertical force on every inner node at load factor one, N, downwards

    Returns
    -------
    LinkSystem
        Links: cables along x, then cables along y. Nodes run along x first.

    Raises
    ------
    CaseError
        If a number is out of range.

    Notes
    -----
    With one force density along each direction, a node is in equilibrium if its height is
    discretely harmonic, which holds for the saddle. The force densities along x and y have the
    ratio :math:`n^2 : m^2`.
    """
    m = n if m is None else m
    if min(n, m) < 2:
        raise CaseError(f"a net needs at least two meshes each way, got {n} x {m}")
    _check_positive(mesh=mesh, prestress=prestress)
    y, x = (axis.ravel() for axis in np.mgrid[: m + 1, : n + 1])
    height = rise * ((2.0 * x / n - 1.0) ** 2 - (2.0 * y / m - 1.0) ** 2)
    position = np.stack([mesh * x, mesh * y, height], axis=1)
    node = np.arange((n + 1) * (m + 1)).reshape(m + 1, n + 1)
    along_x = np.stack([node[1:-1, :-1].ravel(), node[1:-1, 1:].ravel()], axis=1)
    along_y = np.stack([node[:-1, 1:-1].ravel(), node[1:, 1:-1].ravel()], axis=1)
    ends = np.concatenate([along_x, along_y])
    used = np.unique(ends)  # the four corners carry no cable
    number = np.full(node.size, -1)
    number[used] = np.arange(used.size)
    position, ends = position[used], number[ends]

    length = np.sqrt(np.square(position[ends[:, 1]] - position[ends[:, 0]]).sum(axis=1))
    density = np.repeat([1.0, (m / n) ** 2], [len(along_x), len(along_y)]) * prestress / mesh
    edge = (x == 0) | (x == n) | (y == 0) | (y == m)
    fixed = np.repeat(edge[used, None], 3, axis=1)
    load = np.zeros_like(position)
    load[~edge[used], 2] = -nodal_load
    kind = np.zeros(len(ends), dtype=int)
    return LinkSystem(
        position, ends, (cable or Cable(1e7),), kind, fixed, load, prestress=density * length
    )


def _check_positive(**values: float) -> None:
    """Refuse lengths and forces that are not positive."""
    for name, value in values.items():
        if not (value > 0.0 and np.isfinite(value)):
            raise CaseError(f"{name} must be positive, got {value}")

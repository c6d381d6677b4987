"""Structures of links: tensegrity grids, cable nets, tables, line meshes."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from multiscale.errors import CaseError, listed, require, suggest
from multiscale.io.mesh_groups import NamedMesh
from multiscale.laws.link import Bar, Beam, Cable, LinkLaw
from multiscale.macro.links.link_system import LinkSystem

MODULE_ENDS = np.array(
    [[i, (i + 1) % 4] for i in range(4)]  # lower cables
    + [[4 + i, 4 + (i + 1) % 4] for i in range(4)]  # upper cables
    + [[i, 4 + i] for i in range(4)]  # lateral cables
    + [[i, 4 + (i + 1) % 4] for i in range(4)]  # bars
)
"""Links of a module: nodes 0-3 are the lower corners, 4-7 the upper mid-sides."""

FORCE_DENSITY = np.repeat([0.5, 1.0, 1.0, -1.0], 4)
"""Self-stress of a module as tension over length, relative to the upper cables."""

MOTIONS = ("x", "y", "z", "rx", "ry", "rz")  # names of the components of a node in the columns


def tensegrity_grid(
    n: int,
    m: int | None = None,
    *,
    prestress: float = 2550.0,
    size: float = 1.0,
    height: float = 0.5,
    cable: Cable | None = None,
    bar: Bar | None = None,
    nodal_load: float = 40.0,
) -> LinkSystem:
    r"""Double-layer grid of n x m self-stressed quadruplex modules.

    Parameters
    ----------
    n, m : int, number of modules along x and y; m = n if not given
    prestress : float
        Tension of the upper cables at load factor 0, N. The self-stress of a module is, as
        force over length, lower : upper : lateral : bar = 1 : 2 : 2 : -2; with the default shape
        the tensions are as 1 : sqrt 2 : sqrt 2 : -sqrt 6.
    size : float, edge :math:`a` of a module, m
    height : float, distance :math:`h` of the layers, m
    cable : Cable, optional, law of the cables; rigidity 4e6 N if not given
    bar : Bar, optional, law of the bars; rigidity 8e7 N if not given
    nodal_load : float, vertical force on every node at load factor 1, N, positive downwards

    Returns
    -------
    LinkSystem
        Links by module (x fastest): four lower, four upper, four lateral cables and four bars.
        The lower nodes on the edges x = 0 and x = n a are fixed. Neighbouring modules share nodes
        and have parallel cables.

    Notes
    -----
    With the defaults and n = 16 this is the test structure of section 4 of the source: 256
    modules, 3072 cables. The source gives neither the shape nor the stiffness; these are chosen
    so that about 14 % of the cables are slack at load factor 1, as in the source. This share is
    an input, since it depends only on the ratio of load to prestress.

    Examples
    --------
    >>> grid = tensegrity_grid(16)
    >>> grid.n_nodes, grid.n_links
    (833, 4096)
    """
    m = n if m is None else m
    for count in (n, m):
        require("modules along x and y", count, "[1, inf)", integer=True)
    for name, value in (("size", size), ("height", height)):
        require(f"{name} of a module", value, "(0, inf)", "m")
    require("prestress", prestress, "[0, inf)", "N")
    position, modules = _grid_nodes(n, m)
    position = position * np.array([size, size, height])
    ends = modules[:, MODULE_ENDS].reshape(-1, 2)
    span = position[ends[:, 1]] - position[ends[:, 0]]
    length = np.sqrt(np.einsum("li,li->l", span, span))
    density = np.tile(FORCE_DENSITY, n * m) * prestress / (size * np.sqrt(0.5))

    fixed = np.zeros((len(position), 3), dtype=bool)
    fixed[: (n + 1) * (m + 1) : n + 1] = True
    fixed[n : (n + 1) * (m + 1) : n + 1] = True
    load = np.zeros((len(position), 3))
    load[:, 2] = -nodal_load
    return LinkSystem(
        position,
        ends,
        laws=(cable or Cable(4e6), bar or Bar(8e7)),
        kind=np.tile(np.repeat([0, 1], [12, 4]), n * m),
        fixed=fixed,
        load=load,
        prestress=density * length,
        group=np.repeat(np.arange(n * m), 16),
    )


def _grid_nodes(n: int, m: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes in units of size and height, layer by layer, and the eight nodes of every module."""
    lower, along_x = (n + 1) * (m + 1), n * (m + 1)
    j, i = (index.ravel() for index in np.mgrid[: m + 1, : n + 1])
    y_x, x_x = (index.ravel() for index in np.mgrid[: m + 1, :n])
    y_y, x_y = (index.ravel() for index in np.mgrid[:m, : n + 1])
    position = np.concatenate(
        [
            np.stack([i, j, 0.0 * i], axis=1),
            np.stack([x_x + 0.5, y_x, 1.0 + 0.0 * x_x], axis=1),
            np.stack([x_y, y_y + 0.5, 1.0 + 0.0 * x_y], axis=1),
        ]
    )
    j, i = (index.ravel() for index in np.mgrid[:m, :n])
    corner = j * (n + 1) + i
    edge_x, edge_y = lower + j * n + i, lower + along_x + j * (n + 1) + i
    upper = [edge_x, edge_y + 1, edge_x + n, edge_y]
    lowers = [corner, corner + 1, corner + n + 2, corner + n + 1]
    return position, np.stack(lowers + upper, axis=1)


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
    prestress : float, horizontal component of every tension at load factor 0, N
    cable : Cable, optional, law of the cables; rigidity 1e7 N if not given
    nodal_load : float, vertical force on every inner node at load factor 1, N, downwards

    Returns
    -------
    LinkSystem
        Links: cables along x, then cables along y. Nodes run along x first.

    Notes
    -----
    With a constant force density along each direction, a node is in equilibrium if its height is
    discretely harmonic, which the saddle satisfies. The force densities along x and y have the
    ratio :math:`n^2 : m^2`.
    """
    m = n if m is None else m
    for count in (n, m):
        require("meshes along x and y", count, "[2, inf)", integer=True)
    for name, value in (("mesh", mesh), ("prestress", prestress)):
        require(name, value, "(0, inf)")
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


def system_from_table(
    nodes: Mapping[str, Any], links: Mapping[str, Any], laws: Mapping[str, LinkLaw]
) -> LinkSystem:
    """Build a structure from two tables.

    Parameters
    ----------
    nodes : mapping of str to array_like
        Columns by name, such as a dict or a pandas table. ``x``, ``y``, ``z``: position, m.
        Optional: ``fix_x``, ``fix_y``, ``fix_z``: 1 if fixed, else 0; ``load_x``, ...: force at
        load factor 1, N; and with beams ``fix_rx``, ..., ``load_rx``, ...: the same for rotations
        and moments, N m.
    links : mapping of str to array_like
        ``first`` and ``second``: rows of the nodes, from 0; ``law``: name of the law. Optional:
        ``prestress``, N, and ``group``.

    Examples
    --------
    >>> from multiscale.laws.link import Cable
    >>> nodes = {"x": [0.0, 0.0], "y": [0.0, 0.0], "z": [1.0, 0.0], "fix_x": [1, 1],
    ...          "fix_y": [1, 1], "fix_z": [1, 0], "load_z": [0.0, -50.0]}
    >>> links = {"first": [0], "second": [1], "law": ["rope"]}
    >>> rope = system_from_table(nodes, links, {"rope": Cable(rigidity=1e5)})
    >>> rope.length
    array([1.])
    """
    c = 6 if any(isinstance(law, Beam) for law in laws.values()) else 3
    motions = MOTIONS[:c]
    optional = [f"{what}_{motion}" for what in ("fix", "load") for motion in motions]
    _check_columns("nodes", nodes, ["x", "y", "z"], optional)
    _check_columns("links", links, ["first", "second", "law"], ["prestress", "group"])
    position = np.stack([np.asarray(nodes[axis], dtype=float) for axis in "xyz"], axis=1)

    def columns(what: str) -> np.ndarray:
        empty = np.zeros(len(position))
        values = [np.asarray(_get(nodes, f"{what}_{motion}", empty)) for motion in motions]
        return np.stack(values, axis=1).astype(float)

    fixed = columns("fix")
    if wrong := np.argwhere((fixed != 0.0) & (fixed != 1.0)).tolist():
        node, motion = wrong[0]
        raise CaseError(
            f"fix_{motions[motion]} of node {node} must be 1 (fixed) or 0, got "
            f"{fixed[node, motion]:g}; supports do not move"
        )
    names = [str(name) for name in links["law"]]
    known = list(laws)
    for row, name in enumerate(names):
        if name not in laws:
            raise CaseError(f"law {name!r} of link {row} is not among the laws: {known}")
    return LinkSystem(
        position,
        np.stack([np.asarray(links[end], dtype=int) for end in ("first", "second")], axis=1),
        tuple(laws.values()),
        np.array([known.index(name) for name in names], dtype=int),
        fixed == 1.0,
        columns("load"),
        prestress=np.asarray(_get(links, "prestress", np.zeros(0)), dtype=float),
        group=np.asarray(_get(links, "group", np.zeros(0)), dtype=int),
    )


def system_from_mesh(
    mesh: NamedMesh,
    laws: Mapping[str, LinkLaw],
    *,
    supports: tuple[str, ...],
    load: tuple[float, ...] = (0.0, 0.0, 0.0),
    scale: float = 1.0,
) -> LinkSystem:
    """Build a structure from the line elements of a mesh.

    Parameters
    ----------
    mesh : NamedMesh
        Mesh as returned by :func:`multiscale.io.meshes.open_mesh`. Lines belong to named groups.
        Supports are named sets of nodes, or groups of vertex elements.
    laws : mapping of str to LinkLaw, law of every set of lines
    supports : tuple of str, sets of nodes that are fixed in all unknowns
    load : tuple of float
        Force (N), with beams followed by the moment (N m), on every free node at load factor 1.
    scale : float, length unit of the file, m

    Raises
    ------
    CaseError
        If a set is missing, a line has no law or two laws, or the structure is refused.
    """
    c = 6 if any(isinstance(law, Beam) for law in laws.values()) else 3
    ends, kind = [], []
    for index, name in enumerate(laws):
        lines = _cells(mesh, name, "line")
        ends.append(lines)
        kind.append(np.full(len(lines), index))
    used, renumbered = np.unique(np.concatenate(ends), return_inverse=True)
    number = np.full(len(mesh.points), -1)
    number[used] = np.arange(used.size)
    fixed = np.zeros((used.size, c), dtype=bool)
    for name in supports:
        if name in mesh.node_sets:
            points = mesh.node_sets[name]
        else:
            points = np.unique(_cells(mesh, name, "vertex"))
        fixed[number[points][number[points] >= 0]] = True
    force = np.zeros((used.size, c))
    force[:, : len(load)] = load
    force[fixed] = 0.0
    position = np.zeros((used.size, 3))
    position[:, : mesh.points.shape[1]] = scale * mesh.points[used]
    return LinkSystem(
        position,
        renumbered.reshape(-1, 2),
        tuple(laws.values()),
        np.concatenate(kind),
        fixed,
        force,
    )


def _get(table: Mapping[str, Any], name: str, default: np.ndarray) -> Any:
    return table[name] if name in list(table.keys()) else default


def _check_columns(
    what: str, table: Mapping[str, Any], needed: list[str], optional: list[str]
) -> None:
    """Refuse tables with missing, unknown or uneven columns."""
    names = list(table.keys())
    missing = [name for name in needed if name not in names]
    unknown = [name for name in names if name not in needed + optional]
    if missing or unknown:
        known = needed + optional
        faults = [
            f"{fault} column{'s' * (len(columns) > 1)} {', '.join(columns)}"
            for fault, columns in (("lacks the", missing), ("has the unknown", unknown))
            if columns
        ]
        hint = suggest(unknown[0], set(known) - set(names), "") if unknown else ""
        hint = hint or f"known: {', '.join(known)}"
        raise CaseError(f"the table of {what} {' and '.join(faults)}; {hint}")
    sizes = {name: len(table[name]) for name in names}
    if 0 in sizes.values():
        raise CaseError(f"the table of {what} has no rows below its names; give at least one row")
    if len(set(sizes.values())) != 1:
        raise CaseError(f"the columns of {what} must have the same length, got {sizes}")


def _cells(mesh: NamedMesh, name: str, kind: str) -> np.ndarray:
    """Return the elements of a kind in a named group, shape (elements, corners)."""
    members = mesh.groups.get(name, {}).get(kind)
    if members is None:
        known = listed({*(mesh.node_sets if kind == "vertex" else ()), *mesh.groups})
        what = "points" if kind == "vertex" else "lines"
        raise CaseError(f"the mesh has no {what} in a set named {name!r}; its sets: {known}")
    return np.asarray(mesh.cells[kind][members])

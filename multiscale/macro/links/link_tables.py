"""Structures from tables of nodes and links, and from line meshes."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from multiscale.errors import CaseError, listed, suggest
from multiscale.io import NamedMesh
from multiscale.laws.link import Beam, LinkLaw
from multiscale.macro.links.link_system import LinkSystem

__all__ = ["system_from_mesh", "system_from_table"]

MOTIONS = ("x", "y", "z", "rx", "ry", "rz")
"""Names of the components of a node in the columns."""


def system_from_table(
    nodes: Mapping[str, Any], links: Mapping[str, Any], laws: Mapping[str, LinkLaw]
) -> LinkSystem:
    """Build a structure from two tables.

    Parameters
    ----------
    nodes : mapping of str to array_like
        Columns by name, such as a dict or a pandas table. ``x``, ``y``, ``z``: position, m.
        Optional: ``fix_x``, ``fix_y``, ``fix_z``: 1 if fixed, else 0; ``load_x``, ...: force at
        load factor one, N; and with beams ``fix_rx``, ..., ``load_rx``, ...: the same for rotations
        and moments, N m.
    links : mapping of str to array_like
        ``first`` and ``second``: rows of the nodes, from 0; ``law``: name of the law. Optional:
        ``prestress``, N, and ``group``.
    laws : mapping of str to LinkLaw

    Raises
    ------
    CaseError
        If a column is missing or unknown, a support is neither 0 nor 1, a law is unknown, or the
        structure is refused.

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
            f"fix_{motions[motion]} of node {node} must be 1 (held) or 0, got "
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
        Mesh as returned by :func:`multiscale.io.open_mesh`. Lines belong to named groups. Supports
        are named sets of nodes, or groups of vertex elements.
    laws : mapping of str to LinkLaw, law of every set of lines
    supports : tuple of str, sets whose nodes are fixed in all unknowns
    load : tuple of float
        Force (N), with beams followed by the moment (N m), on every free node at load factor one.
    scale : float, length of one unit of the file, m

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
        raise CaseError(f"the table of {what} has no rows below its names; give at least one")
    if len(set(sizes.values())) != 1:
        raise CaseError(f"the columns of {what} must have one length, got {sizes}")


def _cells(mesh: NamedMesh, name: str, kind: str) -> np.ndarray:
    """Return the elements of a kind in a named group, shape (elements, corners)."""
    members = mesh.groups.get(name, {}).get(kind)
    if members is None:
        known = listed({*(mesh.node_sets if kind == "vertex" else ()), *mesh.groups})
        what = "points" if kind == "vertex" else "lines"
        raise CaseError(f"the mesh has no {what} in a set named {name!r}; its sets: {known}")
    return np.asarray(mesh.cells[kind][members])

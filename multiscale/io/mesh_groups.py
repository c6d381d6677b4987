"""Points, elements and named groups of a mesh, whatever the format of its file."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from meshio import Mesh

CORNERS = {
    **{"line": 2, "triangle": 3, "quad": 4},
    **{"tetra": 4, "pyramid": 5, "wedge": 6, "hexahedron": 8},
}
"""Corners of the kinds of elements; the names of elements of second order begin with these."""

NUMBERED = ("gmsh:physical", "netgen:index")
"""Data of elements with the number of their group; the names are stored separately."""


@dataclass(frozen=True)
class NamedMesh:
    """A mesh of any elements with named groups; kinds and the order of nodes as in meshio."""

    points: np.ndarray  # (n, d), coordinates in the unit of the file
    cells: dict[str, np.ndarray]  # points of the elements of every kind, (elements, nodes)
    # elements of every named volume, face, line or vertex, by kind
    groups: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    node_sets: dict[str, np.ndarray] = field(default_factory=dict)  # points of every named set


def named_mesh(mesh: "Mesh") -> NamedMesh:
    """Collect the groups that meshio stores in different places for different formats."""
    data = mesh.cell_data
    numbers = next((data[name] for name in NUMBERED if name in data), None)
    families = getattr(mesh, "cell_tags", {})  # groups of MED by their number
    count: dict[str, int] = {}
    groups: dict[str, dict[str, list[np.ndarray]]] = {}
    for k, block in enumerate(mesh.cells):
        chosen = [(name, sets[k]) for name, sets in mesh.cell_sets.items() if ":" not in name]
        if numbers is not None:  # groups of several dimensions may share a number
            chosen += [
                (name, np.flatnonzero(numbers[k] == tag))
                for name, (tag, dimension) in mesh.field_data.items()
                if dimension == block.dim
            ]
        chosen += [
            (name, np.flatnonzero(data["cell_tags"][k] == number))
            for number, names in families.items()
            for name in names
            if "cell_tags" in data
        ]
        first = count.get(block.type, 0)
        count[block.type] = first + len(block.data)
        for name, numbers_in_block in chosen:
            if numbers_in_block is not None and len(numbers_in_block):
                members = groups.setdefault(name.strip(), {}).setdefault(block.type, [])
                members.append(first + np.asarray(numbers_in_block, dtype=int))
    nodes = {name: np.asarray(points, dtype=int) for name, points in mesh.point_sets.items()}
    for number, names in getattr(mesh, "point_tags", {}).items():
        tagged = np.flatnonzero(mesh.point_data["point_tags"] == number)
        for name in names:
            nodes[name.strip()] = np.append(nodes.get(name.strip(), tagged[:0]), tagged)
    cells = {kind: block for kind, block in mesh.cells_dict.items() if len(block)}
    joined = {
        name: {kind: np.unique(np.concatenate(members)) for kind, members in kinds.items()}
        for name, kinds in groups.items()
    }
    if numbers is not None and not mesh.cell_sets:
        _drop_copies(cells, joined)
    return NamedMesh(mesh.points, cells, joined, nodes)


def _drop_copies(cells: dict[str, np.ndarray], groups: dict[str, dict[str, np.ndarray]]) -> None:
    """Remove repeated elements: numbered formats repeat them for every group that holds them."""
    for kind, nodes in cells.items():
        _, first, copy = np.unique(
            np.sort(nodes, axis=1), axis=0, return_index=True, return_inverse=True
        )
        number = np.argsort(np.argsort(first))[copy.ravel()]
        cells[kind] = nodes[np.sort(first)]
        for members in groups.values():
            if kind in members:
                members[kind] = np.unique(number[members[kind]])

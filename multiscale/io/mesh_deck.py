"""Meshes of decks of Abaqus and CalculiX, with their sets and surfaces."""

import re
from collections.abc import Iterator
from os.path import realpath
from pathlib import Path
from typing import NamedTuple

import numpy as np

from multiscale.errors import CaseError
from multiscale.io.files import read_bytes
from multiscale.io.mesh_groups import CORNERS, NamedMesh

TYPES = (
    re.compile(r"(?:[A-Z]*C3D|SC|CSS)(\d+)"),
    re.compile(r"(?:[A-Z]*CPS|[A-Z]*CPEG?|[A-Z]*CAX|STRI|SFM3D|M3D|R3D|DS|S)(\d+)"),
    re.compile(r"(?:T[23]D(?=2)|B[23](?=[13]))(\d)"),
)
"""Types of solids, plates and straight lines with the number that selects their kind."""

KINDS: tuple[dict[int, str], ...] = (
    {4: "tetra", 10: "tetra10", 8: "hexahedron", 20: "hexahedron20"}
    | {6: "wedge", 15: "wedge15", 5: "pyramid", 13: "pyramid13"},
    {3: "triangle", 6: "triangle6", 65: "triangle6", 4: "quad", 8: "quad8", 9: "quad9"},
    {1: "line", 2: "line", 3: "line"},
)
"""Kinds of elements as in meshio."""

FACES: dict[str, tuple[tuple[int, ...], ...]] = {
    "tetra": ((0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)),
    "hexahedron": (
        *((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1)),
        *((1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)),
    ),
    "triangle": ((0, 1), (1, 2), (2, 0)),
    "quad": ((0, 1), (1, 2), (2, 3), (3, 0)),
}
"""Corners of the faces S1, S2 and so on."""

FACETS = {2: "line", 3: "triangle", 4: "quad"}  # kinds of faces by their number of corners

GENERATING = {"SYSTEM", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY"}
"""Keywords that move nodes, or make nodes and elements."""


class Block(NamedTuple):
    """A keyword, its options, and the numbers and entries of the lines of data below it."""

    keyword: str
    options: dict[str, str]
    rows: list[tuple[int, list[str]]]


Elements = dict[str, list[list[int]]]  # nodes of the elements of every kind

Places = dict[int, tuple[str, int]]
"""Kind of every element, by its number, and its row among the elements of that kind."""


def read_deck(path: Path) -> NamedMesh:
    """Read nodes, elements, sets and surfaces of a deck."""
    blocks = list(_blocks(path))
    names = {name.upper(): name for block in blocks[::-1] for name in block.options.values()}
    try:
        _check_flat(blocks)
        # nodes and elements by their numbers in the deck
        nodes = _nodes(blocks)
        cells, places = _elements(blocks, nodes)
        # sets and surfaces as rows of the elements of each kind
        nsets, elsets = _sets(blocks, "NSET"), _sets(blocks, "ELSET")
        groups: dict[str, dict[str, list[int]]] = {}
        for name, members in elsets.items():
            for kind, row in (places[e] for e in members if e in places):
                groups.setdefault(names[name], {}).setdefault(kind, []).append(row)
        for name, face in _faces(blocks, elsets, cells, places):
            facets = cells.setdefault(kind := FACETS[len(face)], [])
            groups.setdefault(names[name], {}).setdefault(kind, []).append(len(facets))
            facets.append(face)
    except CaseError as error:
        raise CaseError(f"{path}: {error}") from error

    # rows of points replace the numbers of nodes
    number = {node: k for k, node in enumerate(nodes)}
    internal = {
        block.options[block.keyword].upper()
        for block in blocks
        if "INTERNAL" in block.options and block.keyword in block.options
    }
    return NamedMesh(
        np.array(list(nodes.values())),
        {
            kind: np.array([[number[node] for node in element] for element in elements])
            for kind, elements in cells.items()
        },
        {
            name: {kind: np.unique(rows) for kind, rows in kinds.items()}
            for name, kinds in groups.items()
            if name.upper() not in internal
        },
        {
            names[name]: np.array([number[node] for node in members if node in number], dtype=int)
            for name, members in nsets.items()
            if name not in internal
        },
    )


def _blocks(path: Path, above: tuple[str, ...] = ()) -> Iterator[Block]:
    """Split a deck, and the files that it includes, at its keywords; ``above`` include it."""
    if realpath(path) in above:
        raise CaseError(f"{path} includes itself by *INCLUDE; leave that line out")
    above = (*above, realpath(path))
    content = read_bytes(path)
    try:
        text = content.decode()
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    block, header = Block("", {}, []), ""
    for line, raw in enumerate(text.splitlines(), start=1):
        entry = header + raw.strip()
        header = ""
        if not entry or entry.startswith("**"):
            continue
        if not entry.startswith("*"):
            block.rows.append((line, [x.strip().strip('"') for x in entry.split(",")]))
            continue
        if entry.endswith(","):  # the options go on in the next line
            header = entry
            continue
        yield block
        keyword, *options = entry[1:].split(",")
        pairs = (option.partition("=") for option in options)
        given = {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}
        block = Block(keyword.strip().upper(), given, [])
        if block.keyword == "INCLUDE":
            yield from _blocks(path.parent / given.get("INPUT", ""), above)
    yield block


def _check_flat(blocks: list[Block]) -> None:
    """Refuse decks with parts, and nodes or elements that are generated by keywords."""
    instances = [block for block in blocks if block.keyword == "INSTANCE"]
    if len(instances) > 1 or any(block.rows for block in instances):
        raise CaseError(
            "the deck assembles several parts or moves a part; write the body as a deck without "
            "parts and instances"
        )
    for block in blocks:
        if block.keyword in GENERATING or (block.keyword == "NODE" and "SYSTEM" in block.options):
            keyword = block.keyword if block.keyword in GENERATING else "NODE, SYSTEM"
            raise CaseError(
                f"the deck has *{keyword}, which is not read; write each node and each element in "
                f"a separate line"
            )


def _nodes(blocks: list[Block]) -> dict[int, list[float]]:
    nodes: dict[int, list[float]] = {}
    for line, entries in (row for block in blocks if block.keyword == "NODE" for row in block.rows):
        try:
            given = [re.sub("[dD]", "e", x) for x in entries[1:4]]  # exponents of Fortran
            number, position = int(entries[0]), [float(x or 0.0) for x in given]
        except ValueError as error:
            raise CaseError(f"line {line} of *NODE does not define a node: {error}") from error
        position += [0.0] * (3 - len(position))
        if nodes.setdefault(number, position) != position:
            raise CaseError(
                f"line {line} gives node {number} a second place, as in decks of several parts; "
                f"write the body as a deck without parts"
            )
    return nodes


def _connected(block: Block) -> Iterator[tuple[int, list[int]]]:
    """Numbers and nodes of the elements of a block, which may take several lines."""
    kind, entries = _kind(block), list[int]()
    count = (CORNERS.get(kind) or int(re.findall(r"\d+", kind)[0])) if kind else 0
    for line, row in block.rows if kind else ():
        try:
            entries += [int(entry) for entry in row if entry]
        except ValueError as error:
            raise CaseError(
                f"line {line} of *ELEMENT does not define an element: {error}"
            ) from error
        if len(entries) == count + 1 or (kind == "line" and len(entries) > count):
            yield entries[0], entries[1 : 1 + count]
            entries = []
        if len(entries) > count + 1:
            break
    if entries:
        raise CaseError(
            f"element {entries[0]} has {len(entries) - 1} nodes, and {block.options['TYPE']} has "
            f"{count}"
        )


def _kind(block: Block) -> str:
    """Kind of the elements of a block, empty for elements without a shape."""
    given = block.options.get("TYPE", "")
    for pattern, kinds in zip(TYPES, KINDS, strict=True):
        if match := pattern.match(given.upper()):
            if int(match[1]) not in kinds:
                raise CaseError(f"elements of type {given} are not read; mesh with C3D4 or C3D8")
            return kinds[int(match[1])]
    return ""


def _elements(blocks: list[Block], nodes: dict[int, list[float]]) -> tuple[Elements, Places]:
    """Nodes of all elements with a shape, and their places by their numbers."""
    cells: Elements = {}
    places: Places = {}
    for block in (block for block in blocks if block.keyword == "ELEMENT"):
        for number, element in _connected(block):
            if unknown := [node for node in element if node not in nodes]:
                raise CaseError(
                    f"element {number} has node {unknown[0]}, which the deck does not define"
                )
            if number in places:
                raise CaseError(
                    f"two elements have the number {number}, as in decks of several parts; write "
                    f"the body as a deck without parts"
                )
            kind = _kind(block)
            places[number] = kind, len(cells.setdefault(kind, []))
            cells[kind].append(element)
    if not cells:
        raise CaseError("the deck has no elements by *ELEMENT; give the deck that holds the mesh")
    return cells, places


def _sets(blocks: list[Block], key: str) -> dict[str, list[int]]:
    """Members of all sets of nodes or of elements, by names in capitals."""
    sets: dict[str, list[int]] = {}
    for keyword, options, rows in blocks:
        members: list[int] = []
        of_nodes = options.get("TYPE", "").upper() == "NODE"
        if keyword == "SURFACE" and key == "NSET" and of_nodes and options.get("NAME"):
            name = options["NAME"]
            for line, entries in rows:
                members += _members(entries[0], sets, line)
        elif key not in options or keyword not in (key, "NODE", "ELEMENT"):
            continue
        else:
            name = options[key]
            if keyword == "ELEMENT":
                members = [number for number, _ in _connected(Block(keyword, options, rows))]
            elif keyword == "NODE":
                members = [int(entries[0]) for _, entries in rows]
            for line, entries in rows if keyword == key else ():
                given = [entry for entry in entries if entry]
                if "GENERATE" in options and len(given) in (2, 3):
                    first, last, *step = (_members(entry, {}, line)[0] for entry in given)
                    members += range(first, last + 1, *(k or 1 for k in step))
                else:
                    members += [n for entry in given for n in _members(entry, sets, line)]
        sets.setdefault(name.upper(), []).extend(members)
    return sets


def _members(entry: str, sets: dict[str, list[int]], line: int) -> list[int]:
    """Numbers that an entry of a set denotes: the entry, or all members of a set above."""
    for name in (entry, entry.rpartition(".")[2]):  # a part may stand before the name
        if name.isdigit():
            return [int(name)]
        if name.upper() in sets:
            return sets[name.upper()]
    raise CaseError(f"line {line} names {entry!r}, and no line above defines this set")


def _faces(
    blocks: list[Block], elsets: dict[str, list[int]], cells: Elements, places: Places
) -> Iterator[tuple[str, list[int]]]:
    """Names of surfaces of elements, and the nodes at the corners of each face."""
    for keyword, options, rows in blocks:
        of_elements = options.get("TYPE", "ELEMENT").upper() == "ELEMENT"
        if keyword != "SURFACE" or not of_elements or not options.get("NAME"):
            continue
        for line, (entry, *label) in rows:
            side = label[0].upper() if label else ""
            for element in _members(entry, elsets, line):
                if element not in places:
                    raise CaseError(f"line {line} of *SURFACE has an unknown element {element}")
                kind, row = places[element]
                shape = kind.rstrip("0123456789")
                faces = {f"S{k}": face for k, face in enumerate(FACES.get(shape, ()), start=1)}
                faces |= dict.fromkeys(("SPOS", "SNEG"), tuple(range(CORNERS[shape])))
                if side not in faces and shape in FACES:
                    raise CaseError(
                        f"line {line} of *SURFACE names face {side!r} of a {kind}; name a face "
                        f"from S1 to S{len(FACES[shape])}"
                    )
                if side in faces:  # wedges and pyramids have no faces here
                    yield (
                        options["NAME"].upper(),
                        [cells[kind][row][k] for k in faces[side]],
                    )

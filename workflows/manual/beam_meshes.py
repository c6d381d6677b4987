"""Mesh the shipped case ``brake_reuss``: two half-beams clamped by three solid bolts.

    python workflows/manual/beam_meshes.py [FOLDER]

from the root of a checkout writes ``lower.msh`` and ``upper.msh`` in mm into
``microcases/brake_reuss``. The dimensions are of the Brake-Reuss beam: 720 mm long, a lap of
121.412 mm by 25.4 mm, half-beams of 12.7 mm there, holes of 8.433 mm at 0 and 30.175 mm on both
sides of the middle, 5/16 inch bolts with heads and nuts of the area of a hexagon of 12.7 mm across
its flats, and washers of 17.46 mm. Every plan is an O-grid, which is drawn out along z; heads,
washers and nuts are tied to the bodies that they touch. The shank is cut inside the nut.
"""

import sys
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import meshio
import numpy as np

FOLDER = Path(__file__).parents[2] / "microcases" / "brake_reuss"
LENGTH, HALF_LAP, HALF_WIDTH, HEIGHT = 720.0, 60.706, 12.7, 12.7
SPACING, HOLE, WASHER, SHANK = 30.175, 4.2164, 8.73125, 3.75  # the last three are radii
DEPTH = 0.2
"""The place of the cut of the shank, in heights of the nut, and the radius of the shank, between
its nominal radius and thread (3.97 and 3.26 mm), match published frequencies without contact."""
HEAD = np.sqrt(2.0 * np.sqrt(3.0) * 6.35**2 / np.pi)
WASHER_HEIGHT, HEAD_HEIGHT, SHANK_LENGTH = 1.5875, 5.159375, 38.1
SIDES, RINGS, LAYERS, ARM, END = 2, 1, 3, 21, 6
"""Elements along a quarter of a hole, between washer and edge, through the height, of an arm along
its length, and between the last hole's square and the end of the lap. The notch needs most of them:
layers 1, 2, 3 with arm and end in proportion have 171.80, 169.70, 169.33 Hz in the first mode, and
twice the rings change it by .03 %."""

Quads = list[np.ndarray]
"""Anticlockwise quadrilaterals in plan, each of shape (4, 2)."""


@dataclass
class Solid:
    """Hexahedra and named faces of a body as they are drawn out."""

    number: dict[tuple[int, ...], int] = field(default_factory=dict)
    cells: list[list[int]] = field(default_factory=list)
    faces: dict[str, list[list[int]]] = field(default_factory=dict)

    def nodes(self, quad: np.ndarray, z: float) -> list[int]:
        """Numbers of the corners of a quadrilateral at a height."""
        keys = [tuple(np.round([*at, z], 4)) for at in quad]
        return [self.number.setdefault(key, len(self.number)) for key in keys]

    def draw_out(self, quads: Quads, heights: np.ndarray) -> None:
        """Add layers of hexahedra between heights."""
        for quad in quads:
            for low, high in pairwise(heights):
                self.cells.append(self.nodes(quad, low) + self.nodes(quad, high))

    def name(self, face: str, quads: Quads, z: float) -> None:
        """Name quadrilaterals at a height."""
        self.faces.setdefault(face, []).extend(self.nodes(quad, z) for quad in quads)

    def write(self, file: Path) -> None:
        """Write the body as a mesh of gmsh."""
        names = list(self.faces)
        blocks = [("hexahedron", np.array(self.cells))]
        blocks += [("quad", np.array(self.faces[name])) for name in names]
        tags = [np.full(len(block), tag) for tag, (_, block) in enumerate(blocks, start=1)]
        groups = {"solid": np.array([1, 3])}
        groups |= {name: np.array([tag, 2]) for tag, name in enumerate(names, start=2)}
        meshio.Mesh(
            np.array(list(self.number)),
            blocks,
            cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
            field_data=groups,
        ).write(file, file_format="gmsh22", binary=False, float_fmt=".7g")


def main(folder: Path = FOLDER) -> None:
    """Write both half-beams with their parts of the bolts."""
    folder.mkdir(parents=True, exist_ok=True)
    t = np.linspace(-1.0, 1.0, SIDES + 1)[:-1]
    square = np.concatenate([np.c_[0 * t + 1, t], np.c_[-t, 0 * t + 1]])
    square = np.concatenate([square, -square])  # anticlockwise from the corner (1, -1)
    angle = -0.25 * np.pi + 2.0 * np.pi * np.arange(4 * SIDES) / (4 * SIDES)
    circle = np.c_[np.cos(angle), np.sin(angle)]
    # of a polygon with the second moment of area of the circle
    step = angle[1] - angle[0]
    shank = SHANK * (np.sin(step) / step * (2.0 + np.cos(step)) / 3.0) ** -0.25
    box = square * [0.5 * SPACING, HALF_WIDTH]

    lap: Quads = []
    bolts = []
    for x in (-SPACING, 0.0, SPACING):
        hole, head, washer = (radius * circle for radius in (HOLE, HEAD, WASHER))
        rims = [washer + (box - washer) * k / RINGS for k in range(RINGS + 1)]
        seat = [hole, head, washer]
        lap += _rings([*seat, *rims[1:]], x)
        side = np.linspace(-0.5, 0.5, SIDES + 1) * shank
        core = np.stack(np.meshgrid(side, side, indexing="ij"), axis=-1) + np.array([x, 0.0])
        inner = _rings([0.5 * shank * square, shank * circle], x) + _grid(core)
        outer = _rings([shank * circle, hole, head], x)
        bolts.append((_rings(seat, x), inner, outer))
    y = np.linspace(-HALF_WIDTH, HALF_WIDTH, SIDES + 1)
    far = np.linspace(1.0, 0.0, END + 1) ** 1.4  # from the notch, where elements are short
    ends = HALF_LAP - (HALF_LAP - 1.5 * SPACING) * far
    part = np.linspace(0.0, 1.0, ARM + 1)  # short elements at the notch
    arm = HALF_LAP + (0.5 * LENGTH - HALF_LAP) * (0.05 * part + 0.95 * part**2)
    for sign in (1.0, -1.0):
        lap += _strip(sign * ends, y)

    up = HEIGHT * np.linspace(0.0, 1.0, LAYERS + 1) ** 1.5  # thin layers at the notch
    seat, top = HEIGHT + WASHER_HEIGHT, HEIGHT + WASHER_HEIGHT + HEAD_HEIGHT
    cut = -seat - DEPTH * HEAD_HEIGHT
    through = np.array([cut, -seat, *np.linspace(-HEIGHT, HEIGHT, 2 * LAYERS + 1), seat])
    lower, upper = Solid(), Solid()
    for body, way in ((lower, -1.0), (upper, 1.0)):
        body.draw_out(lap, np.sort(way * up))
        body.draw_out(_strip(way * arm, y), np.append(-up[:0:-1], up))
        body.name("joint", lap, 0.0)
    for k, (ring, inner, outer) in enumerate(bolts):
        lower.draw_out(ring, np.array([-seat, -HEIGHT]))
        lower.draw_out(outer, np.array([-top, cut, -seat]))
        lower.draw_out(inner, np.array([seat - SHANK_LENGTH, -top, cut]))
        lower.name(f"cut_{k}", inner, cut)
        upper.draw_out(ring, np.array([HEIGHT, seat]))
        upper.draw_out(inner + outer, np.array([seat, top]))
        upper.draw_out(inner, through)
        upper.name(f"cut_{k}", inner, cut)
    lower.write(folder / "lower.msh")
    upper.write(folder / "upper.msh")


def _rings(curves: list[np.ndarray], x: float) -> Quads:
    """Quadrilaterals between closed curves about (x, 0)."""
    points = np.stack(curves) + np.array([x, 0.0])
    return _grid(np.concatenate([points, points[:, :1]], axis=1))


def _strip(x: np.ndarray, y: np.ndarray) -> Quads:
    """Quadrilaterals between lines along both axes."""
    return _grid(np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1))


def _grid(points: np.ndarray) -> Quads:
    """Anticlockwise quadrilaterals of a grid of points, shape (m, n, 2)."""
    corners = [points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]]
    quads = np.stack(corners, axis=2).reshape(-1, 4, 2)
    x, y = np.moveaxis(quads, 2, 0)
    turn = np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)
    return [item if area > 0.0 else item[::-1] for item, area in zip(quads, turn, strict=True)]


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))

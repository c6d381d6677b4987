"""Meshes of cells from voxels, written for gmsh: overhangs, pores and inclusions."""

import meshio
import numpy as np


def write_voxels(path, filled, volumes=None, *, size=(1.0, 1.0, 1.0), move=None):
    """Write the filled voxels of a box, (nx, ny, nz), as hexahedra with named faces.

    The face ``top`` is all boundary above the lowest layer that is not on a side, from where it can
    be reached along the surface; ``bottom`` is the lowest plane. Pores have no name. ``volumes``
    numbers the named volumes of voxels, and ``move`` changes the points.
    """
    counts = np.array(filled.shape)
    grid = np.stack(np.meshgrid(*(np.arange(n + 1) for n in counts), indexing="ij"), axis=-1)
    points = grid.reshape(-1, 3) / counts * np.array(size)
    number = np.arange(len(points)).reshape(counts + 1)
    corner = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])
    corners = np.vstack([corner, corner + np.array([0, 0, 1])])
    cells, kinds, top, bottom = [], [], [], []
    open_air = reach_from_above(filled)
    for voxel in np.argwhere(filled):
        cells.append([number[tuple(voxel + c)] for c in corners])
        kinds.append(0 if volumes is None else volumes[tuple(voxel)])
        for axis in range(3):
            for side in (0, 1):
                beyond = voxel.copy()
                beyond[axis] += 2 * side - 1
                face = [number[tuple(voxel + c)] for c in square(axis, side)]
                if beyond[2] < 0:
                    bottom.append(face)
                inside = np.all((beyond >= 0) & (beyond < counts))
                if beyond[2] >= counts[2] or (inside and open_air[tuple(beyond)]):
                    top.append(face)
    names = {"bottom": 1, "top": 2, "matrix": 1, "inclusion": 2}
    points = points if move is None else move(points)
    cells, kinds = np.array(cells), np.array(kinds)
    blocks = [("quad", np.array(bottom)), ("quad", np.array(top)), ("hexahedron", cells)]
    tags = [
        np.ones(len(bottom)),
        np.full(len(top), 2),
        1 + kinds if volumes is not None else kinds + 9,
    ]
    used = np.unique(cells)
    renumber = np.full(len(points), -1)
    renumber[used] = np.arange(len(used))
    tags = [entry.astype(int) for entry in tags]
    mesh = meshio.Mesh(
        points[used],
        [(kind, renumber[data]) for kind, data in blocks],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={
            name: np.array([tag, 2 if name in ("bottom", "top") else 3])
            for name, tag in names.items()
            if volumes is not None or name in ("bottom", "top")
        },
    )
    meshio.write(path, mesh, file_format="gmsh22", binary=False)
    return path


def square(axis, side):
    """Corners of a face of the unit voxel, in cyclic order."""
    corners = []
    for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
        total = np.zeros(3, dtype=int)
        total[axis], total[(axis + 1) % 3], total[(axis + 2) % 3] = side, a, b
        corners.append(total)
    return corners


def reach_from_above(filled):
    """Empty voxels that air reaches from above; pores are not."""
    from scipy.ndimage import label

    empty = np.pad(~filled, ((0, 0), (0, 0), (0, 1)), constant_values=True)
    parts, _ = label(empty)
    return (parts == parts[0, 0, -1])[:, :, :-1] & ~filled

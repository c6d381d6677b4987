"""Meshes of boxes and plane blocks, with named faces."""

from typing import TYPE_CHECKING

import numpy as np

from multiscale.errors import CaseError

if TYPE_CHECKING:
    from skfem import Mesh

GROWTH = 1.25
"""Height of a layer of a plane block over the height of the layer below it, nearer its face."""

HEX_ORDER = [0, 4, 3, 1, 7, 5, 2, 6]
"""Places in a hexahedron of VTK of the corners of a hexahedron of scikit-fem."""


def box_mesh(
    size: tuple[float, float, float],
    elements: tuple[int, int, int],
    *,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> "Mesh":
    """Mesh a box with equal hexahedra and name its faces.

    >>> sorted(box_mesh((0.1, 0.1, 0.02), (4, 4, 2)).boundaries)
    ['back', 'bottom', 'front', 'left', 'right', 'top']
    """
    for length, number, axis in zip(size, elements, "xyz", strict=True):
        if not (length > 0.0 and np.isfinite(length)):
            raise CaseError(f"the block must have a positive length along {axis} (m), got {length}")
        if number < 1:
            raise CaseError(f"the block needs at least one element along {axis}, got {number}")
    fractions = [np.linspace(0.0, 1.0, number + 1) for number in elements]
    from skfem import MeshHex

    unit = MeshHex.init_tensor(*fractions).with_boundaries(
        {
            "left": lambda x: x[0] == 0.0,
            "right": lambda x: x[0] == 1.0,
            "front": lambda x: x[1] == 0.0,
            "back": lambda x: x[1] == 1.0,
            "bottom": lambda x: x[2] == 0.0,
            "top": lambda x: x[2] == 1.0,
        }
    )
    return unit.scaled(size).translated(origin)


def plane_block(
    size: tuple[float, float], profile: np.ndarray, *, upper: bool, lift: float = 0.0
) -> "Mesh":
    """Mesh a rectangle, finest at its ``"face"``, which bulges by a periodic profile out of it."""
    from skfem import MeshQuad

    n, (L, H) = profile.size, size
    ratio = H * n / L
    layers = max(2, int(np.ceil(np.log1p(ratio * (GROWTH - 1.0)) / np.log(GROWTH))))
    thickness = GROWTH ** np.arange(layers)
    z = np.append(0.0, np.cumsum(thickness) / thickness.sum())  # distance from the face over H
    mesh = MeshQuad.init_tensor(np.arange(n + 1) / n, z).with_boundaries(
        {"face": lambda x: x[1] == 0.0, "back": lambda x: x[1] == 1.0}
    )
    x, y = mesh.p
    column = np.rint(x * n).astype(int) % n
    place = np.stack([L * (x - 0.5), H * y - (1.0 - y) * profile[column] + lift])
    if upper:
        return MeshQuad(place, mesh.t).with_boundaries(mesh.boundaries)
    mirrored = MeshQuad(place * np.array([[1.0], [-1.0]]), np.ascontiguousarray(mesh.t[::-1]))
    # turned elements: their facets have other numbers
    y = mirrored.p[1]
    return mirrored.with_boundaries(
        {"face": lambda x: x[1] == y.max(), "back": lambda x: x[1] == y.min()}
    )

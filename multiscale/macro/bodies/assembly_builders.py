"""Bodies with rough joints: stacked blocks and a bolted lap joint."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from multiscale.errors import CaseError
from multiscale.fe.boxes import box_mesh
from multiscale.fe.faces import face_operator
from multiscale.fe.lap_mesh import LapShape as LapShape
from multiscale.fe.lap_mesh import lap_meshes
from multiscale.laws.bulk import AnisotropicElastic, Elastic
from multiscale.laws.interface_law import InterfaceLaw
from multiscale.macro.bodies.assembly import Assembly, Interface
from multiscale.macro.bodies.bolt import Bolt
from multiscale.macro.continuum.body import Body, Value

__all__ = ["lap_joint", "stacked_blocks"]

TIMES = (0.0, 1.0)
"""Times of the load cases: a preload of 1 Pa, then a shear of 1 Pa."""


def stacked_blocks(
    size: tuple[float, float, float],
    elements: tuple[int, int, int],
    materials: Sequence[Elastic | AnisotropicElastic],
    laws: Sequence[InterfaceLaw],
) -> Assembly:
    """Stack equal blocks along z, with a rough joint below every one but the first.

    The first is clamped below. The others are guided on their front face (no motion along y) and
    held by the joints alone; pressure and shear, along x, act on the top of the last.

    Parameters
    ----------
    size : tuple of float, lengths of a block along x, y and z, m
    elements : tuple of int, hexahedra of a block along each axis
    materials : sequence of Elastic or AnisotropicElastic, one for each block, two or more
    laws : sequence of InterfaceLaw, one for each joint, from below

    Raises
    ------
    CaseError
        If there are fewer than two blocks, or not one law for each joint.
    """
    count = len(materials)
    if count < 2 or len(laws) != count - 1:
        raise CaseError(
            f"stacked blocks need two or more materials and a law for each joint between them, "
            f"got {count} materials and {len(laws)} laws"
        )
    bodies = []
    for place, material in enumerate(materials):
        mesh = box_mesh(size, elements, origin=(0.0, 0.0, place * size[2]))
        clamped = {"bottom": (0.0, 0.0, 0.0)}
        held = clamped if place == 0 else {"front": (None, 0.0, None)}
        load = {"top": (1.0, 0.0, _preload(-1.0))} if place == count - 1 else {}
        bodies.append(Body(mesh, material, supports=held, tractions=load, bends=True))
    interfaces = [Interface((i, i + 1), ("top", "bottom"), law) for i, law in enumerate(laws)]
    area = size[0] * size[1]
    return Assembly(tuple(bodies), tuple(interfaces), TIMES, (area, area))


def lap_joint(
    shape: LapShape,
    materials: Sequence[Elastic | AnisotropicElastic],
    law: InterfaceLaw,
    shank: float | None = None,
) -> Assembly:
    """Two plates that overlap, with a bolt hole through both and a rough joint between.

    The bolt is a pressure under its washers, on the ring around the hole on both outer faces, which
    does not change with the load, or, with a shank, a :class:`Bolt`. It carries no shear. The lower
    plate is clamped at its far end. The far end of the upper plate is guided along x, where the
    shear pulls.

    Parameters
    ----------
    shape : LapShape, dimensions and mesh
    materials : sequence of Elastic or AnisotropicElastic
        Elasticity of the lower and the upper plate.
    law : InterfaceLaw, on the whole overlap
    shank : float, optional, axial stiffness of the bolt, N/m; see :func:`shank_stiffness`

    Raises
    ------
    CaseError
        If the dimensions do not fit each other, or gmsh cannot be loaded.
    """
    lower, upper = lap_meshes(shape)
    below = Body(
        lower,
        materials[0],
        supports={"end": (0.0, 0.0, 0.0)},
        tractions={} if shank else {"washer": (0.0, 0.0, _preload(1.0))},
        bends=True,
    )
    pressed = {} if shank else {"washer": (0.0, 0.0, _preload(-1.0))}
    above = Body(
        upper,
        materials[1],
        supports={"end": (None, 0.0, 0.0)},
        tractions=pressed | {"end": (1.0, 0.0, 0.0)},
        bends=True,
    )
    interface = Interface((0, 1), ("joint", "joint"), law)
    areas = (_area(above, "washer"), shape.width * shape.thickness)
    bolts = (Bolt((0, 1), ("washer", "washer"), shank, areas[0]),) if shank else ()
    return Assembly((below, above), (interface,), TIMES[bool(bolts) :], areas, bolts=bolts)


def _preload(direction: float) -> Value:
    """Traction of 1 Pa at time 0 that is gone at time 1; workers must be able to import it."""
    return partial(_fading, direction)


def _fading(direction: float, position: np.ndarray, time: float) -> np.ndarray:
    return np.full(position.shape[1], direction * (1.0 - time))


def _area(body: Body, boundary: str) -> float:
    """Area of a boundary, m²."""
    return float(face_operator(body.basis, boundary)[1].sum())

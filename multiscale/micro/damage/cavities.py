"""A representative volume with cavities and flat cracks in closed form."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from multiscale.errors import CaseError
from multiscale.io.images import VoxelImage
from multiscale.micro.damage.shapes import NEGLIGIBLE, Cracks, Cylinders, Mapped, Shapes

__all__ = ["Cavities", "check_box", "voxelise"]


@dataclass(frozen=True)
class Cavities:
    """A box of solid, from the origin to its size, with cavities and flat cracks in it.

    Parameters
    ----------
    size : tuple of float, lengths along x, y and z, m
    bodies : Ellipsoids, Cylinders or Cracks, or a sequence of them
        Cavities and cracks; see :func:`~.shapes.spheres` and its siblings. They may reach out of
        the box, and overlap.
    periodic : bool
        Whether the parts of bodies outside the box enter again on the opposite side. An infinite
        cylinder must then be parallel to an edge.

    Raises
    ------
    CaseError
        If a length is not positive, or an infinite cylinder is tilted in a periodic box.

    Examples
    --------
    >>> from multiscale.micro.damage import spheres
    >>> rve = Cavities((1e-3, 1e-3, 1e-3), [spheres([[5e-4, 5e-4, 5e-4]], 3e-4)])
    """

    size: tuple[float, float, float]
    bodies: Sequence[Shapes] = ()
    periodic: bool = True

    def __post_init__(self) -> None:
        check_box(self.size)
        object.__setattr__(self, "size", tuple(float(length) for length in self.size))
        alone = isinstance(self.bodies, Mapped | Cylinders)
        object.__setattr__(self, "bodies", (self.bodies,) if alone else tuple(self.bodies))
        for kind in self.bodies:
            if self.periodic and isinstance(kind, Cylinders):
                tilted = np.isinf(kind.half_length) & (np.abs(kind.axis).max(axis=1) < 1.0)
                if tilted.any():
                    raise CaseError(
                        f"cylinder {int(np.argmax(tilted))} is infinite and not along an edge of "
                        f"the periodic box; give it a length or set periodic=False"
                    )

    @property
    def volume(self) -> float:
        """Volume of the box, m³."""
        return float(np.prod(self.size))

    @cached_property
    def images(self) -> list[Shapes]:
        """All bodies that reach into the box, with their periodic images."""
        found = []
        size = np.array(self.size)
        for kind in self.bodies:
            reach, centre = kind.reach, kind.centre
            copies = np.zeros((1, 3))
            if self.periodic and len(centre):
                centre = centre - size * np.floor(centre / size)
                finite = np.where(np.isfinite(reach), reach, 0.0)  # infinite along an edge
                n = np.floor(finite.max(axis=0) / size).astype(int) + 1
                copies = np.array(list(product(*(range(-k, k + 1) for k in n)))) * size
            place = centre[None] + copies[:, None]
            inside = np.all((place + reach >= 0.0) & (place - reach <= size), axis=2)
            # a body infinite along an edge is its own image there
            inside &= ~np.any(np.isinf(reach)[None] & (copies[:, None] != 0.0), axis=2)
            which = np.nonzero(inside)[1]
            found.append(kind.take(which, place[inside] - kind.centre[which]))
        return found

    def void_at(self, place: np.ndarray, thickness: float = 0.0) -> np.ndarray:
        """Whether points (3, ...), m, lie in a cavity, or in a crack of a thickness, m."""
        void = np.zeros(place.shape[1:], dtype=bool)
        for kind in self.images:
            for k in range(len(kind.centre)):
                void |= kind.contains(k, place, thickness)
        return void


def check_box(size: tuple[float, float, float]) -> None:
    """Refuse a box without volume."""
    lengths = np.asarray(size, dtype=float)
    if lengths.shape != (3,) or not np.all((lengths > 0.0) & np.isfinite(lengths)):
        raise CaseError(f"the size of a volume must be three positive lengths (m), got {size}")


def voxelise(rve: Cavities, shape: int | tuple[int, int, int]) -> VoxelImage:
    """Make an image of closed forms: a voxel is void if its centre lies in a cavity.

    Parameters
    ----------
    rve : Cavities
        The volume. A flat crack becomes one layer of voxels, as thick as a voxel along its normal.
    shape : int or tuple of int
        Voxels along x, y and z; or along the longest edge, with voxels as close to cubes as
        possible.

    Returns
    -------
    VoxelImage
        The image; the error of its sections and stiffness falls with the size of the voxels.

    Raises
    ------
    CaseError
        If the volume is no ``Cavities``, or an axis has no voxel.
    """
    if not isinstance(rve, Cavities):
        raise CaseError(f"voxelise takes Cavities, got {type(rve).__name__}")
    if np.min(shape) < 1:
        raise CaseError(f"an image needs at least one voxel along every axis, got {shape}")
    size = np.array(rve.size)
    if isinstance(shape, int):
        shape = tuple(np.maximum(1, np.rint(shape * size / size.max())).astype(int).tolist())
    spacing = size / shape
    axes = [(np.arange(n) + 0.5) * h for n, h in zip(shape, spacing, strict=True)]
    void = np.zeros(shape, dtype=bool)
    for kind in rve.images:
        for k, (centre, reach) in enumerate(zip(kind.centre, kind.reach, strict=True)):
            thickness = 0.0
            if isinstance(kind, Cracks):
                thickness = float(np.abs(kind.normal[k]) @ spacing)
                reach = reach + 0.5 * thickness * (1.0 + NEGLIGIBLE)
            window = tuple(
                slice(*np.searchsorted(x, (c - r, c + r)))
                for x, c, r in zip(axes, centre, reach, strict=True)
            )
            points = np.stack(
                np.meshgrid(*(x[part] for x, part in zip(axes, window, strict=True)), indexing="ij")
            )
            void[window] |= kind.contains(k, points, thickness)
    return VoxelImage(void, rve.size)

"""A representative volume with cavities and flat cracks in closed form."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement, product

import numpy as np

from multiscale.errors import CaseError
from multiscale.io.images import VoxelImage
from multiscale.micro.damage.shapes import NEGLIGIBLE, Cracks, Cylinders, Ellipsoids, Mapped, Shapes

__all__ = ["Cavities", "check_box", "first_overlap", "voxelise"]


@dataclass(frozen=True)
class Cavities:
    """A box of solid, from the origin to its size, with cavities and flat cracks in it.

    Parameters
    ----------
    size : tuple of float, lengths along x, y and z, m
    bodies : Ellipsoids, Cylinders or Cracks, or a sequence of them
        Cavities and cracks; see :func:`~.shapes.spheres` and its siblings. They may reach out of
        the box.
    periodic : bool
        Whether the parts of bodies outside the box enter again on the opposite side. An infinite
        cylinder must then be parallel to an edge.
    overlap : bool
        Whether bodies may overlap; overlapping bodies are refused otherwise. Cracks and cylinders
        are represented in this check by balls and round rods that enclose them.

    Raises
    ------
    CaseError
        If a length is not positive, an infinite cylinder is tilted in a periodic box, or bodies
        overlap although ``overlap`` is false.

    Examples
    --------
    >>> from multiscale.micro.damage import spheres
    >>> rve = Cavities((1e-3, 1e-3, 1e-3), [spheres([[5e-4, 5e-4, 5e-4]], 3e-4)])
    """

    size: tuple[float, float, float]
    bodies: Sequence[Shapes] = ()
    periodic: bool = True
    overlap: bool = True

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
        if not self.overlap and (found := first_overlap(self)) is not None:
            a, b = found
            raise CaseError(
                f"bodies {a} and {b} overlap although overlap=False; move them apart, make them "
                f"smaller or set overlap=True"
            )

    @property
    def volume(self) -> float:
        """Volume of the box, m³."""
        return float(np.prod(self.size))

    @cached_property
    def images(self) -> list[Shapes]:
        """All bodies that reach into the box, with their periodic images."""
        return [kind for kind, _ in self.sources()]

    def void_at(self, place: np.ndarray, thickness: float = 0.0) -> np.ndarray:
        """Whether points (3, ...), m, lie in a cavity, or in a crack of a thickness, m."""
        void = np.zeros(place.shape[1:], dtype=bool)
        for kind in self.images:
            for k in range(len(kind.centre)):
                void |= kind.contains(k, place, thickness)
        return void

    def sources(self) -> list[tuple[Shapes, np.ndarray]]:
        """Bodies that reach into the box, and the number of the body whose image each is."""
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
            found.append((kind.take(which, place[inside] - kind.centre[which]), which))
        return found


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


def first_overlap(rve: Cavities) -> tuple[int, int] | None:
    """Find two bodies that overlap and return their numbers, counted through all kinds, or None."""
    images = rve.sources()
    start = np.cumsum([0, *(len(kind.centre) for kind in rve.bodies)])
    for a, b in combinations_with_replacement(range(len(images)), 2):
        (first, own), (second, other) = images[a], images[b]
        for i in range(len(first.centre)):
            later = np.arange(len(second.centre)) > (i if a == b else -1)
            away = np.abs(second.centre - first.centre[i])
            boxes_meet = np.all(away < first.reach[i] + second.reach, axis=1)
            for j in np.flatnonzero(later & boxes_meet):
                if _overlap(first, i, second, int(j)):
                    return int(start[a] + own[i]), int(start[b] + other[j])
    return None


def _overlap(first: Shapes, i: int, second: Shapes, j: int) -> bool:
    """Whether two bodies overlap: exact for ellipsoids, by enclosing rods for other bodies."""
    if isinstance(first, Ellipsoids) and isinstance(second, Ellipsoids):
        away = second.centre[j] - first.centre[i]
        return contact_function(away, first.root[i], second.root[j]) < 1.0
    p, u, r = _rod(first, i)
    q, v, s = _rod(second, j)
    a = b = 0.0  # the nearest points are p + a u and q + b v
    for _ in range(100):  # alternating projections on a convex square
        a = float(np.clip(u @ (q + b * v - p) / max(u @ u, 1e-300), -1.0, 1.0))
        b = float(np.clip(v @ (p + a * u - q) / max(v @ v, 1e-300), -1.0, 1.0))
    return float(np.linalg.norm(p + a * u - q - b * v)) < r + s


def contact_function(away: np.ndarray, first: np.ndarray, second: np.ndarray) -> float:
    r"""Perram and Wertheim's contact function of two ellipsoids: below 1 they overlap.

    .. math:: F = \max_{0 \le s \le 1} s(1-s)\, r^t [(1-s) A + s B]^{-1} r,    \tag{1}

    with :math:`A = R_1 R_1^t`, :math:`B = R_2 R_2^t`, the distance :math:`r` of the centres, shape
    (3,), and the semi-axes :math:`R_1`, :math:`R_2` as columns, shape (3, 3), m.

    References
    ----------
    .. [1] J. W. Perram and M. S. Wertheim, J. Comput. Phys. 58 (1985) 409-416,
       doi:10.1016/0021-9991(85)90171-8.
    """
    from scipy.optimize import minimize_scalar

    A, B = first @ first.T, second @ second.T
    spheres = np.allclose(A, A[0, 0] * np.eye(3)) and np.allclose(B, B[0, 0] * np.eye(3))
    if spheres:
        return float(away @ away / (np.sqrt(A[0, 0]) + np.sqrt(B[0, 0])) ** 2)

    def negative(s: float) -> float:
        return float(-s * (1.0 - s) * away @ np.linalg.solve((1.0 - s) * A + s * B, away))

    return -float(minimize_scalar(negative, bounds=(0.0, 1.0), method="bounded").fun)


def _rod(kind: Shapes, k: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Centre, half axis and radius, m, of a round rod (or ball) that encloses a body."""
    if isinstance(kind, Cylinders):
        half = min(kind.half_length[k], 1e6 * kind.radius[k])
        return kind.centre[k], half * kind.axis[k], float(kind.radius[k])
    assert isinstance(kind, Mapped)
    return kind.centre[k], np.zeros(3), float(np.linalg.norm(kind.root[k], 2))

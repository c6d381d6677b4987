r"""Damage on plane sections, eq (1) of the source: :math:`D(n) = \delta S_D / \delta S`."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import product
from math import gcd
from typing import Protocol, runtime_checkable

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.io.images import VoxelImage
from multiscale.micro.damage.cavities import perpendicular
from multiscale.schema import DAMAGE_SECTIONS, Dataset

QUANTILES = (0.5, 0.9, 0.95, 0.99)  # reported quantiles of the damage over all sections
LARGEST_INDEX = 12  # largest Miller index of a plane that counts as closed
N_STARTS = 4  # number of worst sections from which the local search starts
MOST_STEPS, SMALLEST_SHARE, LEAST_GAIN = 100, 1e-7, 1e-12  # of the local search


@runtime_checkable
class Volume(Protocol):
    """A box of solid with voids: closed forms (:class:`Cavities`) or an image (VoxelImage)."""

    @property
    def size(self) -> tuple[float, float, float]:
        """Lengths along x, y and z, m."""

    def section_areas(
        self, normal: np.ndarray, distance: np.ndarray, slab: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Areas of void and whole areas of plane sections, m², at distances from the centre, m."""

    def image(self, shape: int) -> VoxelImage:
        """Image with a number of voxels along the longest edge; an image returns itself."""

    def coarser(self) -> "Volume | None":
        """Volume of half the resolution; None for closed forms and single layers of voxels."""

    def void_at(self, place: np.ndarray, thickness: float = 0.0) -> np.ndarray:
        """Whether points (3, ...), m, lie in a void, or in a crack of a thickness, m."""

    def window(self, share: float, corner: Sequence[int]) -> "Volume":
        """Return a smaller box, a share of the edges, at a corner, (0 or 1) x 3."""


def plane_damage(
    rve: Volume,
    normal: np.ndarray | Sequence[float],
    offset: float | np.ndarray = 0.0,
    *,
    slab: float = 0.0,
    closed: bool = False,
) -> np.ndarray:
    r"""Compute the damage on parallel planes, eq (1) of the source.

    Parameters
    ----------
    normal : array_like, shape (3,), direction :math:`n`, of any length but zero
    offset : float or ndarray
        Distance of the planes from the centre of the volume along the normal, m.
    slab : float
        Thickness of the slab about a plane, m. Flat cracks in it count with their projection on
        the plane, :math:`A\,|n \cdot m|`, since the section of a flat crack is a line without
        area. With 0 only the cracks that the plane meets count.
    closed : bool
        Whether the plane continues through the periodic medium until it closes, instead of ending
        at the box. The normal must then be a lattice direction of the box.

    Returns
    -------
    ndarray, shape of ``offset``
        :math:`D = S_D / S` with the area of the section within the box, exact up to round-off
        for closed forms (overlaps are counted once) and for the voxels of an image. NaN where
        the plane misses the box.

    Examples
    --------
    >>> from multiscale.micro.damage import Cavities, spheres
    >>> rve = Cavities((1.0, 1.0, 1.0), [spheres([[0.5, 0.5, 0.5]], 0.3)])
    >>> float(plane_damage(rve, (0, 0, 1)).round(5))
    0.28274
    """
    _check_volume(rve)
    direction = _unit(normal)
    require("the thickness of the slab", slab, "[0, inf)", "m")
    distances = np.atleast_1d(np.asarray(offset, dtype=float))
    places = distances.ravel()
    if closed:  # copies of the plane in the box, at distances of a period
        period = _period(direction, rve.size)
        half = 0.5 * float(np.abs(direction) @ rve.size)
        first = places - period * np.floor((places + half) / period)
        copies = [first + k * period for k in range(int(np.ceil(2.0 * half / period)) + 1)]
    else:
        copies = [places]
    lost, area = np.sum([rve.section_areas(direction, copy, slab) for copy in copies], axis=0)
    with np.errstate(invalid="ignore"):
        damage = np.where(area > 0.0, lost / area, np.nan)
    return np.asarray(np.clip(damage, 0.0, 1.0).reshape(np.shape(offset)))


def max_damage(
    rve: Volume,
    *,
    level: int = 2,
    sections: int = 65,
    slab: float = 0.0,
    closed: bool = False,
    smallest_section: float = 0.5,
    refine: bool = True,
) -> Dataset:
    """Search the worst plane, and compute the distribution of damage over all planes.

    Parameters
    ----------
    level : int
        Refinement of the sphere of normals, see :func:`sphere_directions`; edges
        and diagonals of the box are always among the normals.
    slab, closed
        See :func:`plane_damage`; normals of closed planes are lattice directions with Miller
        indices up to ``level + 1``.
    smallest_section : float
        Smallest area of a section over the area of the section through the centre, dimensionless;
        smaller sections, at the corners of the box, are not representative and left out.
    refine : bool, whether a local search improves the worst sections

    Returns
    -------
    Dataset
        Follows ``DAMAGE_SECTIONS``: every section, the worst plane, mean and quantiles, and the
        tensor of anisotropy. For an image ``resolution_error`` is the change of the damage of the
        worst plane at half the resolution.
    """
    _check_volume(rve)
    if sections < 1 or level < 0 or not 0.0 <= smallest_section < 1.0:
        raise CaseError(
            f"sections must be at least 1, level at least 0 and smallest_section from 0 to below "
            f"1, got {sections}, {level} and {smallest_section:g}"
        )
    # damage of all sections
    normals = (
        lattice_directions(rve.size, level + 1) if closed else section_normals(rve.size, level)
    )
    offset = np.array([_offsets(rve, n, sections, smallest_section, closed) for n in normals])
    measure = partial(plane_damage, rve, slab=slab, closed=closed)
    damage = np.array([measure(n, d) for n, d in zip(normals, offset, strict=True)])
    row, column = np.unravel_index(damage.argmax(), damage.shape)
    worst, normal, place = float(damage[row, column]), normals[row], float(offset[row, column])
    # local search from the worst sections
    if refine:
        smallest = 0.0 if closed else smallest_section
        climbs = _refine(
            rve.size, measure, normals, offset, damage, smallest=smallest, turn=not closed
        )
        worst, normal, place = max((worst, normal, place), *climbs, key=lambda plane: plane[0])
    values = {
        "normal": normals,
        "offset": offset,
        "damage": damage,
        "maximum_damage": worst,
        "worst_normal": normal,
        "worst_offset": place,
        "mean_damage": damage.mean(),
        "quantile_damage": np.quantile(damage, QUANTILES),
        "quantile": np.array(QUANTILES),
        "anisotropy": fit_tensor(normals, damage.max(axis=1)),
        "box_size": np.array(rve.size),
    }
    if (coarse := rve.coarser()) is not None:
        change = plane_damage(coarse, normal, place, slab=slab, closed=closed) - worst
        values["resolution_error"] = abs(float(change))
    return DAMAGE_SECTIONS.build(values, slab=slab, closed=int(closed))


def section_normals(size: tuple[float, float, float], level: int) -> np.ndarray:
    """List unit normals (n, 3): edges and diagonals of a box, then a refined sphere."""
    lattice, sphere = lattice_directions(size, 1), sphere_directions(level)
    apart = np.abs(sphere @ lattice.T).max(axis=1) < 1.0 - 1e-9
    return np.concatenate([lattice, sphere[apart]])


def _period(normal: np.ndarray, size: tuple[float, float, float]) -> float:
    """Distance of a closed plane to its next periodic copy, m."""
    return 1.0 / float(np.linalg.norm(miller_indices(normal, size) / np.array(size)))


def _offsets(
    rve: Volume, normal: np.ndarray, sections: int, smallest: float, closed: bool
) -> np.ndarray:
    """Offsets, m, at the middles of equal intervals where sections are large enough."""
    from multiscale.numerics.box_sections import box_section

    if closed:
        largest = 0.5 * _period(normal, rve.size)
    else:
        smaller, largest = 0.0, 0.5 * float(np.abs(normal) @ rve.size)
        least = smallest * box_section(rve.size, normal, np.zeros(1))
        while largest - smaller > 1e-12 * largest:  # along an edge of the box all are large enough
            middle = 0.5 * (smaller + largest)
            enough = box_section(rve.size, normal, np.array([middle])) >= least
            smaller, largest = (middle, largest) if enough else (smaller, middle)
    return largest * (2.0 * (np.arange(sections) + 0.5) / sections - 1.0)


def _refine(
    size: tuple[float, float, float],
    measure: Callable[[np.ndarray, float], np.ndarray],
    normals: np.ndarray,
    offset: np.ndarray,
    damage: np.ndarray,
    *,
    smallest: float,
    turn: bool,
) -> Iterator[tuple[float, np.ndarray, float]]:
    """Maximise damage locally from the worst sections; without ``turn`` only offsets change."""
    from multiscale.numerics.box_sections import box_section

    step = float(np.ptp(offset, axis=1).max()) / max(1, 2 * (offset.shape[1] - 1))
    step = step or 0.1 * min(size)
    peak = damage.argmax(axis=1)
    for row in np.argsort(damage.max(axis=1))[::-1][:N_STARTS]:
        normal, place = normals[row], float(offset[row, peak[row]])
        frame = perpendicular(normal[None])[0] if turn else np.empty((0, 3))

        def plane(
            x: np.ndarray, n: np.ndarray = normal, d: float = place, frame: np.ndarray = frame
        ) -> tuple[np.ndarray, float]:
            return _unit(n + x[:-1] @ frame), float(d + step * x[-1])

        def value(x: np.ndarray, plane: Callable[..., tuple[np.ndarray, float]] = plane) -> float:
            n, d = plane(x)
            if smallest:
                centre, area = box_section(size, n, np.array([0.0, d]))
                if area < smallest * centre:
                    return 0.0
            lost = float(measure(n, d))
            return lost if np.isfinite(lost) else 0.0

        x, top = _climb(value, np.array([0.1, 0.1, 1.0] if turn else [1.0]))
        yield top, *plane(x)


def _climb(value: Callable[[np.ndarray], float], step: np.ndarray) -> tuple[np.ndarray, float]:
    """Maximise from the origin by compass search (Kolda et al., doi:10.1137/S003614450242889)."""
    place, top, share = np.zeros(len(step)), value(np.zeros(len(step))), 1.0
    directions = [*np.diag(step), *np.diag(-step)]
    for _ in range(MOST_STEPS):
        for direction in directions:
            height = value(place + share * direction)
            if height > top + LEAST_GAIN:
                place, top = place + share * direction, height
                break
        else:
            share *= 0.25
            if share < SMALLEST_SHARE:
                break
    return place, top


def _check_volume(rve: object) -> None:
    if not isinstance(rve, Volume):
        raise CaseError(
            f"sections need Cavities or a VoxelImage, got {type(rve).__name__}; an array becomes "
            f"an image by VoxelImage(array, size) with its size (m)"
        )


def _unit(normal: np.ndarray | Sequence[float]) -> np.ndarray:
    vector = np.asarray(normal, dtype=float)
    size = float(np.linalg.norm(vector))
    if vector.shape != (3,) or not (size > 0.0 and np.isfinite(size)):
        raise CaseError(f"the normal of a plane must be a direction in space, got {normal}")
    return vector / size


def sphere_directions(level: int) -> np.ndarray:
    """Distribute normals evenly over half a sphere, by halving the edges of an icosahedron."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = [
        np.roll([0.0, a, b * golden], k) for k in range(3) for a, b in product((-1, 1), repeat=2)
    ]
    points = np.array(corners) / np.hypot(1.0, golden)
    for _ in range(level):
        distance = np.linalg.norm(points[:, None] - points[None], axis=2)
        # the five or six neighbours of a corner; lengths of edges differ by less than a half
        nearest = np.sort(distance, axis=1)[:, 1:2]
        near = np.triu(distance < 1.4 * np.minimum(nearest, nearest.T), k=1)
        i, j = np.nonzero(near)
        middle = points[i] + points[j]
        points = np.concatenate([points, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
    return _without_opposites(points)


def lattice_directions(size: tuple[float, float, float], largest: int = 2) -> np.ndarray:
    """List the normals of the lattice planes of a periodic box."""
    span = range(-largest, largest + 1)
    indices = [m for m in product(span, repeat=3) if gcd(*m) == 1]
    indices.sort(key=lambda m: sum(abs(k) for k in m))
    normals = np.array(indices, dtype=float) / size
    return _without_opposites(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def miller_indices(normal: np.ndarray, size: tuple[float, float, float]) -> tuple[int, int, int]:
    """Return the Miller indices of a normal, of any length, in a periodic box."""
    ratio = normal * np.asarray(size)
    ratio = ratio / np.abs(ratio).max()
    for multiple in range(1, LARGEST_INDEX + 1):
        rounded = np.rint(multiple * ratio)
        if np.abs(multiple * ratio - rounded).max() < 1e-7 * multiple:
            h, k, l_ = (int(m) for m in rounded)
            return (h, k, l_)
    raise CaseError(
        f"a plane with the normal {np.array2string(normal, precision=4)} does not close in a "
        f"periodic box of {size} m within indices of {LARGEST_INDEX}; leave out closed=True or "
        f"take a lattice direction"
    )


def fit_tensor(normals: np.ndarray, values: np.ndarray) -> np.ndarray:
    r"""Second-order tensor nearest to a function of the normal."""
    x, y, z = normals.T
    columns = np.stack([x * x, y * y, z * z, 2 * y * z, 2 * x * z, 2 * x * y], axis=1)
    a, b, c, d, e, f = np.linalg.lstsq(columns, values, rcond=None)[0]
    return np.array([[a, f, e], [f, b, d], [e, d, c]])


def _without_opposites(points: np.ndarray) -> np.ndarray:
    distinct: list[np.ndarray] = []
    for point in points:
        x, y, z = np.round(point, 9)
        if z < 0 or (z == 0 and (y < 0 or (y == 0 and x < 0))):
            point = -point
        if not distinct or np.abs(np.array(distinct) @ point).max() < 1.0 - 1e-9:
            distinct.append(point)
    return np.array(distinct)

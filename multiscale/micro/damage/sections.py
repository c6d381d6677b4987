r"""Damage on plane sections, eq (1) of the source: :math:`D(n) = \delta S_D / \delta S`.

This damage is a geometric quantity. The stiffness is :math:`E (1 - D)` only where cavities run
through the volume along the normal, see :mod:`~multiscale.micro.damage.rve`; and the maximum over
the planes of a random medium falls towards its porosity as the volume grows.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from multiscale.errors import CaseError
from multiscale.io.images import VoxelImage
from multiscale.micro.damage.cavities import Cavities
from multiscale.micro.damage.directions import (
    fit_tensor,
    lattice_directions,
    miller_indices,
    sphere_directions,
)
from multiscale.micro.damage.section_plane import SectionPlane
from multiscale.schema import DAMAGE_SECTIONS, Dataset

__all__ = ["box_polygon", "max_damage", "plane_damage", "section_normals"]

QUANTILES = (0.5, 0.9, 0.95, 0.99)  # quantiles of the damage over all sections that are reported
CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])  # of a unit box
EDGES = np.array([(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit]).T
N_STARTS = 4  # number of worst sections from which the local search starts
MOST_STEPS, SMALLEST_SHARE, LEAST_GAIN = 100, 1e-7, 1e-12  # of the local search


def plane_damage(
    rve: Cavities | VoxelImage,
    normal: np.ndarray | Sequence[float],
    offset: float | np.ndarray = 0.0,
    *,
    slab: float = 0.0,
    closed: bool = False,
) -> np.ndarray:
    r"""Compute the damage on planes with one normal, eq (1) of the source.

    Parameters
    ----------
    rve : Cavities or VoxelImage
    normal : array_like, shape (3,), direction :math:`n`, of any length but zero
    offset : float or ndarray
        Distance of the planes from the centre of the volume along the normal, m.
    slab : float
        Thickness of the slab about a plane, m. Flat cracks in it count with their projection on
        the plane, :math:`A\,|n \cdot m|`, since the section of a flat crack is a line without
        area. With 0 the cracks count that the plane meets.
    closed : bool
        Whether the plane continues through the periodic medium until it closes, instead of ending
        at the box. The normal must then be a lattice direction of the box.

    Returns
    -------
    ndarray, shape of ``offset``
        :math:`D = S_D / S` with the area of the section within the box, exact up to round-off
        for closed forms (overlaps are counted once) and for the voxels of an image. NaN where
        the plane misses the box.

    Raises
    ------
    CaseError
        If the normal is no direction, the slab is negative, or a plane does not close.

    Examples
    --------
    >>> from multiscale.micro.damage import Cavities, spheres
    >>> rve = Cavities((1.0, 1.0, 1.0), [spheres([[0.5, 0.5, 0.5]], 0.3)])
    >>> float(plane_damage(rve, (0, 0, 1)).round(5))
    0.28274
    """
    _check_volume(rve)
    direction = _unit(normal)
    if not (slab >= 0.0 and np.isfinite(slab)):
        raise CaseError(f"the slab must have a thickness of at least 0 (m), got {slab:g}")
    distances = np.atleast_1d(np.asarray(offset, dtype=float))
    lost, area = _sections(rve, direction, distances.ravel(), slab, closed)
    with np.errstate(invalid="ignore"):
        damage = np.where(area > 0.0, lost / area, np.nan)
    return np.asarray(np.clip(damage, 0.0, 1.0).reshape(np.shape(offset)))


def max_damage(
    rve: Cavities | VoxelImage,
    *,
    level: int = 2,
    sections: int = 65,
    slab: float = 0.0,
    closed: bool = False,
    smallest_section: float = 0.5,
    refine: bool = True,
) -> Dataset:
    """Search the worst plane, and describe the distribution of damage over all planes.

    Parameters
    ----------
    rve : Cavities or VoxelImage
    level : int
        Refinement of the sphere of normals, see :func:`~.directions.sphere_directions`; edges
        and diagonals of the box are always among the normals.
    sections : int
    slab, closed
        As of :func:`plane_damage`; normals of closed planes are lattice directions with Miller
        indices up to ``level + 1``.
    smallest_section : float
        Share of the section through the centre; planes with a smaller section are left out, since
        a corner of the box is not representative. Dimensionless.
    refine : bool
        Whether the worst plane is searched between the sections, from a few of them.

    Returns
    -------
    Dataset
        Follows ``DAMAGE_SECTIONS``: every section, the worst plane, mean and quantiles, and the
        tensor of anisotropy. For an image ``resolution_error`` is the change of the damage of the
        worst plane at half the resolution.

    Raises
    ------
    CaseError
        If :func:`plane_damage` refuses its arguments, or an option is out of range.
    """
    _check_volume(rve)
    if sections < 1 or level < 0 or not 0.0 <= smallest_section < 1.0:
        raise CaseError(
            f"sections must be at least 1, level at least 0 and smallest_section from 0 to below "
            f"1, got {sections}, {level} and {smallest_section:g}"
        )
    normals = (
        lattice_directions(rve.size, level + 1) if closed else section_normals(rve.size, level)
    )
    offset = np.array([_offsets(rve, n, sections, smallest_section, closed) for n in normals])
    damage = np.array(
        [
            plane_damage(rve, n, d, slab=slab, closed=closed)
            for n, d in zip(normals, offset, strict=True)
        ]
    )
    worst, normal, place = _refine(
        rve,
        normals,
        offset,
        damage,
        slab=slab,
        closed=closed,
        smallest=smallest_section,
        starts=N_STARTS if refine else 0,
    )
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
    if isinstance(rve, VoxelImage) and min(rve.void.shape) > 1:
        coarse = plane_damage(rve.coarsened(), normal, place, slab=slab, closed=closed)
        values["resolution_error"] = abs(float(coarse) - worst)
    return DAMAGE_SECTIONS.build(values, slab=slab, closed=int(closed))


def section_normals(size: tuple[float, float, float], level: int) -> np.ndarray:
    """List unit normals (n, 3): edges and diagonals of a box, then a sphere of some refinement."""
    lattice, sphere = lattice_directions(size, 1), sphere_directions(level)
    apart = np.abs(sphere @ lattice.T).max(axis=1) < 1.0 - 1e-9
    return np.concatenate([lattice, sphere[apart]])


def _sections(
    rve: Cavities | VoxelImage, normal: np.ndarray, distances: np.ndarray, slab: float, closed: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Area of void and whole area of sections, m²."""
    if closed:
        period = 1.0 / np.linalg.norm(miller_indices(normal, rve.size) / np.array(rve.size))
        half = 0.5 * float(np.abs(normal) @ rve.size)
        lost, area = np.zeros(len(distances)), np.zeros(len(distances))
        # a closed plane consists of its copies in the box, one period apart
        first = distances - period * np.floor((distances + half) / period)
        for copy in range(int(np.ceil(2.0 * half / period)) + 1):
            parts = _sections(rve, normal, first + copy * period, slab, closed=False)
            lost, area = lost + parts[0], area + parts[1]
        return lost, area

    from multiscale.micro.damage.planar import Ellipses, union_area
    from multiscale.micro.damage.voxel_sections import box_section, void_section

    if isinstance(rve, VoxelImage):
        return void_section(rve, normal, distances), box_section(rve.size, normal, distances)
    bodies, size = rve.images, np.array(rve.size)
    lost, area = np.zeros(len(distances)), np.zeros(len(distances))
    through = SectionPlane.through(0.5 * size, normal, slab)
    for k, distance in enumerate(distances):
        plane = replace(through, origin=0.5 * size + distance * normal)
        polygon = box_polygon(plane, size)
        if len(polygon) > 2:
            (x, y), after = polygon.T, np.arange(1 - len(polygon), 1)
            area[k] = 0.5 * float(x @ y[after] - y @ x[after])
            sets = Ellipses.join([kind.section(plane) for kind in bodies])
            lost[k] = union_area(polygon, sets)
    return lost, area


def box_polygon(plane: SectionPlane, size: np.ndarray) -> np.ndarray:
    """Corners of the section of a box with a plane, anticlockwise in the plane, shape (n, 2), m.

    There are none if the plane misses the box.
    """
    corners = CORNERS * size
    height = (corners - plane.origin) @ plane.normal
    below = height <= 0.0
    start, end = EDGES[:, below[EDGES[0]] != below[EDGES[1]]]
    share = (height[start] / (height[start] - height[end]))[:, None]
    points = (1.0 - share) * corners[start] + share * corners[end]
    flat = (points - plane.origin) @ plane.frame.T
    x, y = (flat - flat.sum(axis=0) / max(len(flat), 1)).T
    return np.asarray(flat[np.argsort(np.arctan2(y, x))])


def _offsets(
    rve: Cavities | VoxelImage, normal: np.ndarray, sections: int, smallest: float, closed: bool
) -> np.ndarray:
    """Offsets at the middle of equal parts of the range where sections are large enough, m.

    With an edge of the box as normal and more sections than voxels, several planes lie in one
    layer of voxels; all of them count.
    """
    from multiscale.micro.damage.voxel_sections import box_section

    if closed:
        largest = 0.5 / float(np.linalg.norm(miller_indices(normal, rve.size) / np.array(rve.size)))
    else:
        smaller, largest = 0.0, 0.5 * float(np.abs(normal) @ rve.size)
        least = smallest * box_section(rve.size, normal, np.zeros(1))
        while largest - smaller > 1e-12 * largest:  # along an edge of the box all are large enough
            middle = 0.5 * (smaller + largest)
            enough = box_section(rve.size, normal, np.array([middle])) >= least
            smaller, largest = (middle, largest) if enough else (smaller, middle)
    return largest * (2.0 * (np.arange(sections) + 0.5) / sections - 1.0)


def _refine(
    rve: Cavities | VoxelImage,
    normals: np.ndarray,
    offset: np.ndarray,
    damage: np.ndarray,
    *,
    slab: float,
    closed: bool,
    smallest: float,
    starts: int,
) -> tuple[float, np.ndarray, float]:
    """Maximise damage locally from the worst sections found; closed planes keep their normal."""
    from multiscale.micro.damage.voxel_sections import box_section

    step = float(np.ptp(offset, axis=1).max()) / max(1, 2 * (offset.shape[1] - 1)) or 0.1 * min(
        rve.size
    )
    peak = damage.argmax(axis=1)
    rows = np.argsort(damage.max(axis=1))[::-1]
    row = rows[0]
    best = (float(damage[row, peak[row]]), normals[row], float(offset[row, peak[row]]))
    for row in rows[:starts]:
        frame = SectionPlane.through(np.zeros(3), normals[row]).frame

        def plane(
            x: np.ndarray, row: int = row, frame: np.ndarray = frame
        ) -> tuple[np.ndarray, float]:
            turn = x[:-1] @ frame if len(x) == 3 else 0.0
            return _unit(normals[row] + turn), float(offset[row, peak[row]] + step * x[-1])

        def value(x: np.ndarray) -> float:
            n, d = plane(x)
            if not closed:
                centre, area = box_section(rve.size, n, np.array([0.0, d]))
                if area < smallest * centre:
                    return 0.0
            found = float(plane_damage(rve, n, d, slab=slab, closed=closed))
            return found if np.isfinite(found) else 0.0

        x, found = _climb(value, np.array([1.0] if closed else [0.1, 0.1, 1.0]))
        if found > best[0]:
            best = (found, *plane(x))
    return best


def _climb(value: Callable[[np.ndarray], float], step: np.ndarray) -> tuple[np.ndarray, float]:
    """Climb from the origin by steps along the axes, which get shorter where none leads up.

    References
    ----------
    .. [1] T. G. Kolda, R. M. Lewis and V. Torczon, SIAM Rev. 45 (2003) 385-482,
       doi:10.1137/S003614450242889. Compass search, algorithm 1.
    """
    place, top, share = np.zeros(len(step)), value(np.zeros(len(step))), 1.0
    ways = [*np.diag(step), *np.diag(-step)]
    for _ in range(MOST_STEPS):
        for way in ways:
            found = value(place + share * way)
            if found > top + LEAST_GAIN:
                place, top = place + share * way, found
                break
        else:
            share *= 0.25
            if share < SMALLEST_SHARE:
                break
    return place, top


def _check_volume(rve: object) -> None:
    """Refuse objects that are no volume, such as a bare array."""
    if not isinstance(rve, Cavities | VoxelImage):
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

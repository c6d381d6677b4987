"""Volumes with cavities and flat cracks in closed form: bodies, sections, images, packings."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import ceil, exp, log, pi
from typing import NamedTuple, Self

import numpy as np

from multiscale.errors import CaseError, require
from multiscale.io.images import VoxelImage, check_box

NEGLIGIBLE = 1e-9  # ratio of a length to the size of its body below which it counts as zero
CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])  # of a unit box
EDGES = np.array([(a, a | bit) for bit in (1, 2, 4) for a in range(8) if not a & bit]).T


class SectionPlane(NamedTuple):
    """A plane with coordinates y: x = origin + y @ frame."""

    origin: np.ndarray  # (3,), a point of the plane, m
    normal: np.ndarray  # (3,), unit normal
    frame: np.ndarray  # (2, 3), directions in the plane, right-handed with the normal
    slab: float = 0.0  # thickness of the slab about the plane in which flat cracks count, m


def perpendicular(unit: np.ndarray) -> np.ndarray:
    """Return the two vectors, (n, 2, 3), that complete unit vectors (n, 3) to right-hand frames."""
    x, y, z = unit.T  # T. Duff et al., J. Comput. Graph. Tech. 6 (2017) 1-8
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    frame = np.empty((len(unit), 2, 3))
    frame[:, 0] = np.stack([1.0 + sign * x * x * a, sign * x * y * a, -sign * x], axis=1)
    frame[:, 1] = np.stack([x * y * a, sign + y * y * a, -y], axis=1)
    return frame


def _box_polygon(plane: SectionPlane, size: np.ndarray) -> np.ndarray:
    """Corners of the section of a box with a plane, anticlockwise, (n, 2), m; n = 0 outside."""
    corners = CORNERS * size
    height = (corners - plane.origin) @ plane.normal
    below = height <= 0.0
    start, end = EDGES[:, below[EDGES[0]] != below[EDGES[1]]]
    share = (height[start] / (height[start] - height[end]))[:, None]
    points = (1.0 - share) * corners[start] + share * corners[end]
    flat = (points - plane.origin) @ plane.frame.T
    x, y = (flat - flat.sum(axis=0) / max(len(flat), 1)).T
    return np.asarray(flat[np.argsort(np.arctan2(y, x))])


@dataclass(frozen=True)
class CavityShapes(ABC):
    """Bodies centre + root @ w, abs(w) <= 1."""

    centre: np.ndarray  # (n, 3), m
    root: np.ndarray  # (n, 3, 3), or (n, 3, 2) of flat bodies, with the semi-axes as columns, m

    @property
    def reach(self) -> np.ndarray:
        """Half lengths of the bounding boxes, m."""
        return np.asarray(np.linalg.norm(self.root, axis=2))

    @property
    def flat(self) -> bool:
        """Whether the bodies are cracks."""
        return bool(self.root.shape[2] == 2)

    def take(self, index: np.ndarray, shift: np.ndarray) -> Self:
        """Select bodies, moved by a shift of shape (3,) or (selected, 3), m."""
        return type(self)(self.centre[index] + shift, self.root[index])

    def thickness(self, spacing: np.ndarray) -> np.ndarray:
        """Thickness of each crack in an image of a spacing, m; zero for bodies with a volume."""
        return np.zeros(len(self.centre))

    @abstractmethod
    def section(self, plane: SectionPlane) -> tuple[np.ndarray, np.ndarray]:
        """Centres, (k, 2), and roots, (k, 2, 2), of the ellipses in a plane section, m."""

    def contains(self, k: int, points: np.ndarray, thickness: float) -> np.ndarray:
        """Whether points (3, ...) lie in body k, or within half a thickness, m, of a crack."""
        return self._within(k, points - self.centre[k].reshape(3, *(1,) * (points.ndim - 1)))

    def _within(self, k: int, away: np.ndarray) -> np.ndarray:
        inverse = np.linalg.pinv if self.flat else np.linalg.inv
        w = np.tensordot(inverse(self.root[k]), away, axes=1)
        return np.asarray(np.sum(w**2, axis=0) <= 1.0)


class Ellipsoids(CavityShapes):
    """Ellipsoidal cavities."""

    @property
    def volume(self) -> np.ndarray:
        """Volumes, shape (n,), m³."""
        return np.asarray(4.0 / 3.0 * np.pi * np.abs(np.linalg.det(self.root)))

    def section(self, plane: SectionPlane) -> tuple[np.ndarray, np.ndarray]:
        """Ellipses of the section: in the unit ball the plane is (R^T n) . w = -d."""
        distance = (self.centre - plane.origin) @ plane.normal
        support = np.einsum("nij,i->nj", self.root, plane.normal)
        height = np.linalg.norm(support, axis=1)
        cut = np.abs(distance) < height
        c, R, m = self.centre[cut], self.root[cut], support[cut] / height[cut, None]
        s = -distance[cut] / height[cut]
        circle = np.sqrt((1.0 - s) * (1.0 + s))[:, None, None] * perpendicular(m)
        centre = (c - plane.origin + np.einsum("nij,nj->ni", R, s[:, None] * m)) @ plane.frame.T
        return centre, np.einsum("ai,nij,nkj->nak", plane.frame, R, circle)


class Cracks(CavityShapes):
    """Flat elliptic cracks."""

    @property
    def normal(self) -> np.ndarray:
        """Unit normals, shape (n, 3)."""
        across = np.cross(self.root[:, :, 0], self.root[:, :, 1])
        return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True))

    @property
    def area(self) -> np.ndarray:
        """Areas, shape (n,), m²."""
        across = np.cross(self.root[:, :, 0], self.root[:, :, 1])
        return np.asarray(np.pi * np.linalg.norm(across, axis=1))

    def thickness(self, spacing: np.ndarray) -> np.ndarray:
        """Thickness of a layer of voxels along the normal of each crack, m."""
        return np.asarray(np.abs(self.normal) @ spacing)

    def section(self, plane: SectionPlane) -> tuple[np.ndarray, np.ndarray]:
        """Projections of the cracks that meet the slab of the plane, with area A abs(n . m)."""
        distance = np.abs((self.centre - plane.origin) @ plane.normal)
        height = np.linalg.norm(np.einsum("nij,i->nj", self.root, plane.normal), axis=1)
        size = self.reach.max(axis=1)
        meets = distance <= 0.5 * plane.slab + height + NEGLIGIBLE * size
        root = np.einsum("ai,nij->naj", plane.frame, self.root)
        meets &= np.abs(np.linalg.det(root)) * np.pi > NEGLIGIBLE * self.area
        return (self.centre[meets] - plane.origin) @ plane.frame.T, root[meets]

    def contains(self, k: int, points: np.ndarray, thickness: float) -> np.ndarray:
        """Whether points lie within half a thickness of crack k."""
        away = points - self.centre[k].reshape(3, *(1,) * (points.ndim - 1))
        above = np.tensordot(self.normal[k], away, axes=1)
        # of two layers of points at the same distance, only the upper layer is inside
        low, high = -0.5 * thickness * (1.0 + NEGLIGIBLE), 0.5 * thickness * (1 - NEGLIGIBLE)
        return np.asarray(self._within(k, away) & (above > low) & (above <= high))


def spheres(centre: np.ndarray, radius: float | np.ndarray) -> Ellipsoids:
    """Spherical cavities; centres, shape (n, 3), m, and radii, m, which must be positive."""
    centre = _points(centre)
    return Ellipsoids(centre, _radii(radius, len(centre))[:, None, None] * np.eye(3))


def penny_cracks(
    centre: np.ndarray, normal: np.ndarray | Sequence[float], radius: float | np.ndarray
) -> Cracks:
    """Circular flat cracks; a radius that is not positive and a normal of zero are refused.

    Parameters
    ----------
    centre, normal : ndarray, shape (n, 3), m, and of any length
    radius : float or ndarray, shape (n,), m
    """
    centre = _points(centre)
    radii = _radii(radius, len(centre))
    normals = np.broadcast_to(np.asarray(normal, dtype=float), centre.shape)
    size = np.linalg.norm(normals, axis=1)
    if not np.all((size > 0.0) & np.isfinite(size)):
        raise CaseError(f"the normal of a body must be a direction, got {normals[np.argmin(size)]}")
    across = perpendicular(normals / size[:, None])
    return Cracks(centre, np.swapaxes(across, 1, 2) * radii[:, None, None])


def _points(centre: np.ndarray) -> np.ndarray:
    points = np.atleast_2d(np.asarray(centre, dtype=float))
    if points.size == 0:
        return np.empty((0, 3))
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"centres must have shape (n, 3), got {points.shape}")
    if not np.all(np.isfinite(points)):
        raise CaseError("the centres of bodies must be finite (m)")
    return points


def _radii(value: float | np.ndarray, n: int) -> np.ndarray:
    values = np.broadcast_to(np.asarray(value, dtype=float), (n,))
    wrong = ~(values > 0.0) | np.isinf(values)
    if wrong.any():
        k = int(np.argmax(wrong))
        raise CaseError(
            f"the radius of a body must be positive and finite (m), got {values[k]:g} for body {k}"
        )
    return values


@dataclass(frozen=True)
class Cavities:
    """A box of solid, from the origin to its size, with cavities and flat cracks.

    Parameters
    ----------
    size : tuple of float, lengths along x, y and z, m
    bodies : Ellipsoids or Cracks, or a sequence of them
        Cavities and cracks, of :func:`spheres` or :func:`penny_cracks`. They may reach out of
        the box, and overlap.
    periodic : bool, whether bodies that reach out of the box continue on the opposite side

    Examples
    --------
    >>> from multiscale.micro.damage import spheres
    >>> rve = Cavities((1e-3, 1e-3, 1e-3), [spheres([[5e-4, 5e-4, 5e-4]], 3e-4)])
    """

    size: tuple[float, float, float]
    bodies: Sequence[CavityShapes] = ()
    periodic: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", check_box(self.size))
        single = isinstance(self.bodies, CavityShapes)
        object.__setattr__(self, "bodies", (self.bodies,) if single else tuple(self.bodies))

    @cached_property
    def images(self) -> list[CavityShapes]:
        """All bodies that reach into the box, with their periodic images."""
        images = []
        size = np.array(self.size)
        for kind in self.bodies:
            reach, centre = kind.reach, kind.centre
            copies = np.zeros((1, 3))
            if self.periodic and len(centre):
                centre = centre - size * np.floor(centre / size)
                n = np.floor(reach.max(axis=0) / size).astype(int) + 1
                copies = np.array(list(product(*(range(-k, k + 1) for k in n)))) * size
            place = centre[None] + copies[:, None]
            inside = np.all((place + reach >= 0.0) & (place - reach <= size), axis=2)
            which = np.nonzero(inside)[1]
            images.append(kind.take(which, place[inside] - kind.centre[which]))
        return images

    def section_areas(
        self, normal: np.ndarray, distance: np.ndarray, slab: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Areas of void and whole areas of plane sections, m², at distances from the centre, m."""
        from multiscale.micro.damage.ellipse_union import union_area

        lost, area = np.zeros(len(distance)), np.zeros(len(distance))
        middle = 0.5 * np.array(self.size)
        frame = perpendicular(normal[None])[0]
        for k, d in enumerate(distance):
            plane = SectionPlane(middle + d * normal, normal, frame, slab)
            polygon = _box_polygon(plane, np.array(self.size))
            if len(polygon) > 2:
                (x, y), after = polygon.T, np.arange(1 - len(polygon), 1)
                area[k] = 0.5 * float(x @ y[after] - y @ x[after])
                ellipses = [kind.section(plane) for kind in self.images]
                centre = np.concatenate([np.empty((0, 2)), *(c for c, _ in ellipses)])
                root = np.concatenate([np.empty((0, 2, 2)), *(M for _, M in ellipses)])
                turned = root[:, 0, 0] * root[:, 1, 1] < root[:, 0, 1] * root[:, 1, 0]
                root = np.where(turned[:, None, None], root[:, :, ::-1], root)
                lost[k] = union_area(polygon, centre, root)
        return lost, area

    def image(self, shape: int | tuple[int, int, int]) -> VoxelImage:
        """Return an image, see :func:`voxelise`."""
        return voxelise(self, shape)

    def coarser(self) -> None:
        """Return nothing: closed forms have no resolution."""

    def void_at(self, place: np.ndarray, thickness: float = 0.0) -> np.ndarray:
        """Whether points (3, ...), m, lie in a cavity, or in a crack of a thickness, m."""
        void = np.zeros(place.shape[1:], dtype=bool)
        for kind in self.images:
            for k in range(len(kind.centre)):
                void |= kind.contains(k, place, thickness)
        return void

    def window(self, share: float, corner: Sequence[int]) -> "Cavities":
        """Cut a smaller box, a share of the edges, at a corner, (0 or 1) x 3; not periodic."""
        x, y, z = (share * edge for edge in self.size)
        away = np.array(corner) * (1.0 - share) * np.array(self.size)
        inside = [
            kind.take(np.arange(len(kind.centre)), np.broadcast_to(-away, kind.centre.shape))
            for kind in self.images
        ]
        return Cavities((x, y, z), inside, periodic=False)


def voxelise(rve: Cavities, shape: int | tuple[int, int, int]) -> VoxelImage:
    """Convert closed forms to an image: a voxel is void if its centre lies in a cavity.

    Parameters
    ----------
    rve : Cavities
        The volume. A flat crack becomes a layer of voxels, as thick as a voxel along its normal.
    shape : int or tuple of int
        Voxels along x, y and z; or along the longest edge, with voxels as close to cubes as
        possible.

    Returns
    -------
    VoxelImage
        The image; the error of its sections and stiffness falls with the size of the voxels.
    """
    if not isinstance(rve, Cavities):
        raise CaseError(f"voxelise takes Cavities, got {type(rve).__name__}")
    if np.min(shape) < 1:
        raise CaseError(f"an image needs at least 1 voxel along every axis, got {shape}")
    size = np.array(rve.size)
    if isinstance(shape, int):
        shape = tuple(np.maximum(1, np.rint(shape * size / size.max())).astype(int).tolist())
    spacing = size / shape
    axes = [(np.arange(n) + 0.5) * h for n, h in zip(shape, spacing, strict=True)]
    void = np.zeros(shape, dtype=bool)
    for kind in rve.images:
        thickness = kind.thickness(spacing)
        reach = kind.reach + 0.5 * thickness[:, None] * (1.0 + NEGLIGIBLE)
        for k, (centre, half) in enumerate(zip(kind.centre, reach, strict=True)):
            window = tuple(
                slice(*np.searchsorted(x, (c - r, c + r)))
                for x, c, r in zip(axes, centre, half, strict=True)
            )
            points = np.stack(
                np.meshgrid(*(x[span] for x, span in zip(axes, window, strict=True)), indexing="ij")
            )
            void[window] |= kind.contains(k, points, float(thickness[k]))
    return VoxelImage(void, rve.size)


def random_spheres(
    size: tuple[float, float, float],
    radius: float,
    *,
    porosity: float,
    seed: int,
    spread: float = 0.0,
    max_tries: int = 100_000,
) -> Cavities:
    """Spherical cavities that do not overlap, by random sequential addition.

    Parameters
    ----------
    size : tuple of float, lengths of the box along x, y and z, m
    radius : float, median radius, m
    porosity : float
        Volume fraction, met up to the rounding of the number of spheres; at most about 0.38.
    spread : float, standard deviation of the logarithm of the log-normal radii; 0 gives equal radii
    max_tries : int, largest number of places tried for a sphere
    """
    check_box(size)
    _check(radius, porosity, spread)
    rng, box = np.random.default_rng(seed), np.array(size)
    # radii with volumes that add up to the porosity as closely as a number can
    volume = porosity * float(np.prod(size))
    if spread == 0.0:
        radii = np.full(round(volume / _mean_volume(radius, 0.0)), radius)
    else:
        drawn = np.empty(0)
        while (filled := np.cumsum(4.0 / 3.0 * pi * drawn**3)).max(initial=0.0) < volume:
            drawn = np.append(drawn, radius * np.exp(spread * rng.standard_normal(64)))
        radii = drawn[: int(np.argmin(np.abs(np.append(0.0, filled) - volume)))]
    radii = -np.sort(-radii)
    # places, from the largest sphere on
    if len(radii) and 2.0 * radii[0] > box.min():
        raise CaseError(
            f"spheres of radius {radii[0]:g} m overlap their periodic images in a box of {size} m; "
            f"make the box larger"
        )
    places = np.empty((0, 3))
    while (done := len(places)) < len(radii):
        for _ in range(ceil(max_tries / 1000)):
            trial = rng.uniform(size=(1000, 3)) * box
            free = np.ones(1000, dtype=bool)
            for place, reach in zip(places, radii[:done] + radii[done], strict=True):
                away = trial - place
                away -= box * np.rint(away / box)
                free &= np.sum(away**2, axis=1) >= reach**2
            if free.any():
                places = np.vstack([places, trial[np.argmax(free)]])
                break
        else:
            raise CaseError(
                f"there is no free place after {done} of {len(radii)} spheres; a "
                f"porosity of {porosity:g} is too large for random addition: reduce it, or allow "
                f"spheres overlap"
            )
    return Cavities(size, [spheres(places, radii)] if len(radii) else [])


def boolean_spheres(
    size: tuple[float, float, float],
    radius: float,
    *,
    porosity: float,
    seed: int,
    spread: float = 0.0,
) -> Cavities:
    r"""Spherical cavities at independent random places, which may overlap.

    Their number is drawn from Poisson's distribution with the mean :math:`-V \ln(1-\phi) / v` for
    the porosity :math:`\phi` and the mean volume :math:`v` of a sphere, which makes the expected
    volume fraction the porosity, from 0 to below 1. Arguments as for :func:`random_spheres`.
    """
    check_box(size)
    rng = np.random.default_rng(seed)
    _check(radius, porosity, spread)
    mean = -log(1.0 - porosity) * float(np.prod(size)) / _mean_volume(radius, spread)
    count = int(rng.poisson(mean))
    places = rng.uniform(size=(count, 3)) * np.array(size)
    radii = radius * np.exp(spread * rng.standard_normal(count))
    return Cavities(size, [spheres(places, radii)] if count else [])


def _mean_volume(radius: float, spread: float) -> float:
    return 4.0 / 3.0 * pi * radius**3 * exp(4.5 * spread**2)


def _check(radius: float, porosity: float, spread: float) -> None:
    require("the porosity", porosity, "[0, 1)")
    require("the radius of the spheres", radius, "(0, inf)", "m")
    require("the spread of radii", spread, "[0, 1]")


@dataclass(frozen=True)
class Recipe:
    r"""Distribution of random volumes with pores and cracks.

    Parameters
    ----------
    porosity : float, volume fraction of the pores, 0 without pores
    pore_radius : float, median radius of the pores, m
    pore_spread : float, standard deviation of the logarithm of the radii of pores
    overlap : bool, whether pores may overlap
    crack_density : float, :math:`\rho = N \langle a^3 \rangle / V` of the cracks, 0 without cracks
    crack_radius : float, median radius a of the cracks, m
    crack_spread : float, standard deviation of the logarithm of the radii of cracks
    crack_normal : tuple of float, optional
        Normal of all cracks; directions are evenly distributed over the sphere if not given.
    """

    porosity: float = 0.0
    pore_radius: float = 0.0
    pore_spread: float = 0.0
    overlap: bool = False
    crack_density: float = 0.0
    crack_radius: float = 0.0
    crack_spread: float = 0.0
    crack_normal: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.crack_density < 0.0 or self.porosity < 0.0:
            raise CaseError(
                f"porosity and crack density must not be negative, got {self.porosity:g} and "
                f"{self.crack_density:g}"
            )
        for share, radius, name in (
            (self.porosity, self.pore_radius, "pore_radius"),
            (self.crack_density, self.crack_radius, "crack_radius"),
        ):
            if share > 0.0:
                require(name, radius, "(0, inf]", "m")

    def draw(self, size: tuple[float, float, float], seed: int) -> Cavities:
        """Draw a periodic volume of a size, m."""
        place = boolean_spheres if self.overlap else random_spheres
        bodies = []
        if self.porosity:
            pores = place(
                size, self.pore_radius, porosity=self.porosity, seed=seed, spread=self.pore_spread
            )
            bodies += [*pores.bodies]
        rng = np.random.default_rng([seed, 1])  # cracks do not depend on the pores
        mean_cube = self.crack_radius**3 * exp(4.5 * self.crack_spread**2)
        count = (
            round(self.crack_density * float(np.prod(size)) / mean_cube)
            if self.crack_density
            else 0
        )
        if count:
            centres = rng.uniform(size=(count, 3)) * np.array(size)
            normals = rng.standard_normal((count, 3))
            normals = normals if self.crack_normal is None else np.array(self.crack_normal)
            radii = self.crack_radius * np.exp(self.crack_spread * rng.standard_normal(count))
            bodies.append(penny_cracks(centres, normals, radii))
        return Cavities(size, bodies)

"""Binary images of a volume, from a tomograph or from closed forms."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from multiscale.errors import CaseError
from multiscale.io.files import first_line, missing_file

MOST_VOXELS = 2**30  # of an image


def check_box(size: Sequence[float], of: str = "a volume") -> tuple[float, ...]:
    """Return the size of a box, m; a box without volume is refused."""
    lengths = np.asarray(size, dtype=float)
    if lengths.shape != (3,) or not np.all((lengths > 0.0) & np.isfinite(lengths)):
        raise CaseError(f"the size of {of} must be three positive lengths (m), got {size}")
    return tuple(lengths.tolist())


@dataclass(frozen=True)
class VoxelImage:
    """A box of solid and void voxels; other values and lengths are refused."""

    void: np.ndarray  # of bool or of 0 and 1, (nx, ny, nz), whether a voxel is void
    size: tuple[float, float, float]  # lengths along x, y and z, m

    def __post_init__(self) -> None:
        image = np.asarray(self.void)
        if image.ndim != 3 or image.size == 0:
            raise CaseError(
                f"an image of a volume needs three axes with voxels, got shape {image.shape}"
            )
        if image.dtype != bool:
            low, high = image.min(), image.max()
            if not np.all((image == 0) | (image == 1)):
                raise CaseError(
                    f"the image is not binary: its values run from {low} to {high}; pass a "
                    f"comparison such as image < threshold, true where there is void"
                )
            image = image == 1
        object.__setattr__(self, "void", np.ascontiguousarray(image))
        object.__setattr__(self, "size", check_box(self.size, "an image"))

    @property
    def spacing(self) -> tuple[float, float, float]:
        """Edges of a voxel along x, y and z, m."""
        x, y, z = (length / n for length, n in zip(self.size, self.void.shape, strict=True))
        return (x, y, z)

    @property
    def porosity(self) -> float:
        """Volume fraction of void."""
        return float(self.void.mean())

    @property
    def floating(self) -> np.ndarray:
        """Whether a voxel is solid that floats in voids, shape (nx, ny, nz).

        A floating piece has no common face of voxels with the largest piece and touches at most
        one side of the box: pieces between two sides may be supported outside.
        """
        from scipy.ndimage import label

        pieces, number = label(~self.void)
        sides = np.zeros(number + 1, int)
        for axis, end in product(range(3), (0, -1)):
            sides[np.unique(np.take(pieces, end, axis))] += 1
        supported = sides > 1
        largest = np.argmax(np.bincount(pieces.ravel(), minlength=2)[1:]) + 1 if number else 0
        supported[0] = supported[largest] = True
        floating: np.ndarray = ~supported[pieces]
        return floating

    def without_floating(self) -> "VoxelImage":
        """Return the image with void in place of solid that floats in voids."""
        return VoxelImage(self.void | self.floating, self.size)

    def coarsened(self) -> "VoxelImage":
        """Halve the resolution: a voxel is void if more than half of its 8 voxels are."""
        shape = [n - n % 2 for n in self.void.shape]
        if min(shape) < 2:
            raise CaseError(f"an image of {self.void.shape} voxels cannot be coarsened")
        whole = self.void[: shape[0], : shape[1], : shape[2]]
        fine = whole.reshape(shape[0] // 2, 2, shape[1] // 2, 2, shape[2] // 2, 2)
        count = fine.sum(axis=(1, 3, 5))
        # every second undecided voxel is void, so that the porosity keeps its mean
        odd = np.indices(count.shape).sum(axis=0) % 2
        x, y, z = (n * h for n, h in zip(shape, self.spacing, strict=True))
        return VoxelImage((count > 4) | ((count == 4) & (odd == 1)), (x, y, z))

    def coarser(self) -> "VoxelImage | None":
        """Halve the resolution, if there are two voxels or more along every axis."""
        return self.coarsened() if min(self.void.shape) > 1 else None

    def image(self, shape: int) -> "VoxelImage":
        """Return the image as it is, whatever the number of voxels."""
        return self

    def section_areas(
        self, normal: np.ndarray, distance: np.ndarray, slab: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Areas of void and whole areas of plane sections, m², at distances from the centre, m."""
        from multiscale.numerics.box_sections import box_section, void_section

        lost = void_section(self.void, self.size, normal, distance)
        return lost, box_section(self.size, normal, distance)

    def void_at(self, place: np.ndarray, thickness: float = 0.0) -> np.ndarray:
        """Whether points (3, ...), m, lie in a void voxel."""
        across = (3, *(1,) * (place.ndim - 1))
        index = np.floor(place / np.reshape(self.spacing, across)).astype(int)
        index = np.clip(index, 0, np.reshape(self.void.shape, across) - 1)
        return np.asarray(self.void[tuple(index)])

    def window(self, share: float, corner: Sequence[int]) -> "VoxelImage":
        """Cut a box with a share of the edges out of a corner, (0 or 1) x 3, in whole voxels."""
        n = [max(1, round(share * k)) for k in self.void.shape]
        start = [far * (k - m) for far, k, m in zip(corner, self.void.shape, n, strict=True)]
        cut = tuple(slice(a, a + m) for a, m in zip(start, n, strict=True))
        x, y, z = (m * h for m, h in zip(n, self.spacing, strict=True))
        return VoxelImage(self.void[cut], (x, y, z))


def read_images(
    path: str | PathLike[str],
    *,
    void_value: float = 0.0,
    voxel_size: float | Sequence[float] | None = None,
) -> VoxelImage:
    """Read a stack of images: a TIFF file with many pages, or a folder of TIFF slices.

    Parameters
    ----------
    path : path
        File, or folder with ``.tif`` or ``.tiff`` files as slices along z, in the order of their
        names with numbers as numbers.
    void_value : float, value of void voxels; the image must have at most a second value
    voxel_size : float or sequence of float, optional
        Edge of cubic voxels, or edges along x, y and z, m. Read from the file if not given.

    Returns
    -------
    VoxelImage, the volume, with columns of the pages along x, rows along y and pages along z

    Raises
    ------
    CaseError
        If the file is missing, cannot be read, is not a binary stack, has no size of its voxels,
        or tifffile is not installed.
    """
    path = Path(path)
    if not path.exists():
        raise CaseError(missing_file(path))
    pages, edges_in_file = _read_pages(path)
    if pages.ndim != 3:
        raise CaseError(
            f"{path}: contains an array of shape {pages.shape}; give a stack of grey images"
        )
    values = np.unique(pages)
    if values.size > 2 or (values.size == 2 and void_value not in values):
        raise CaseError(
            f"{path}: not a binary image with void {void_value:g}: {values.size} values from "
            f"{values[0]:g} to {values[-1]:g}; threshold it first, or name the void_value"
        )
    edges = voxel_size if voxel_size is not None else edges_in_file
    if edges is None:
        raise CaseError(
            f"{path}: the file does not give the size of its voxels along x, y and z; give "
            f"voxel_size (m), three edges if they are not cubes"
        )
    if np.size(edges) not in (1, 3):
        raise CaseError(
            f"{path}: voxel_size is the edge of a cube or three edges along x, y and z (m), "
            f"got {edges}"
        )
    void = (pages == void_value).transpose(2, 1, 0)
    x, y, z = (float(length) for length in np.broadcast_to(np.ravel(edges), (3,)) * void.shape)
    try:
        return VoxelImage(void, (x, y, z))
    except CaseError as error:
        raise CaseError(f"{path}: {error}") from error


def _read_pages(path: Path) -> tuple[np.ndarray, tuple[float, float, float] | None]:
    """Read the pages (z, y, x) and, if the file has all three, the edges of the voxels, m."""
    try:
        import tifffile
    except ImportError as error:
        raise CaseError(
            f"{path}: reading images needs tifffile; install it with pip install "
            f'"multiscale-contact[images]"'
        ) from error
    try:
        if path.is_dir():
            names = [str(p) for p in path.iterdir() if p.suffix.lower() in {".tif", ".tiff"}]
            slices = tifffile.natural_sorted(names)
            if not slices:
                raise CaseError(f"{path}: the folder has no .tif file; give the slices as TIFF")
            count, pages = 0, []
            for name in slices:
                with tifffile.TiffFile(name) as file:
                    count += _check_count(Path(name), file, count)
                    pages.append(np.asarray(file.asarray()))
            return _stack(path, [Path(p) for p in slices], pages), None
        with tifffile.TiffFile(path) as file:
            _check_count(path, file)
            return np.asarray(file.asarray()), _voxel_edges(file)
    except CaseError:
        raise
    except Exception as error:  # damaged files raise exceptions of any kind
        raise CaseError(
            f"{path}: cannot be read as images ({first_line(error)}); export it again"
        ) from error


def _check_count(path: Path, file: Any, before: int = 0) -> int:
    """Return the number of voxels of a file, unless it has too many with those before it."""
    shape = file.series[0].shape
    if before + prod(shape) > MOST_VOXELS:
        raise CaseError(
            f"{path}: with its array of shape {shape} the image has more than {MOST_VOXELS:,} "
            f"voxels; give a part of it, or larger voxels"
        )
    return prod(shape)


def _stack(path: Path, files: list[Path], pages: list[np.ndarray]) -> np.ndarray:
    first = pages[0]
    for file, page in zip(files, pages, strict=True):
        if page.shape != first.shape or page.dtype != first.dtype:
            raise CaseError(
                f"{path}: the slices are of two formats, {first.shape} of {first.dtype} in "
                f"{files[0].name} and {page.shape} of {page.dtype} in {file.name}; give slices of "
                f"a single format"
            )
    return np.stack(pages)


def _voxel_edges(file: Any) -> tuple[float, float, float] | None:
    """Edges of the voxels, m, in the metadata of ImageJ: resolution in x and y, spacing in z."""
    lengths = {"micron": 1e-6, "um": 1e-6, "\\u00B5m": 1e-6, "mm": 1e-3, "nm": 1e-9, "m": 1.0}
    about = file.imagej_metadata or {}
    unit = lengths.get(str(about.get("unit", "")).replace("µ", "u"))
    tags = file.pages[0].tags
    if unit is None or "spacing" not in about or "XResolution" not in tags:
        return None
    (a, b), (c, d) = tags["XResolution"].value, tags["YResolution"].value
    if not (a and c):
        return None
    return (unit * b / a, unit * d / c, unit * float(about["spacing"]))

"""Tables of a representative volume in a case: its pores and cracks, its size, its solid."""

from collections.abc import Iterator
from itertools import product
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, field_validator, model_validator

from multiscale.errors import CaseError
from multiscale.io.images import VoxelImage, read_images
from multiscale.micro.damage import Cavities, Recipe, penny_cracks, spheres
from multiscale.micro.damage.cavities import CavityShapes
from multiscale.micro.damage.sections import Volume
from multiscale.pipeline.tables import toml_model as toml
from multiscale.units import readable

MOST = 20_000  # largest number of pores and cracks of a volume; thousands are representative

Coordinate = Annotated[float, toml.quantity("m"), toml.with_unit("m")]
Point = tuple[Coordinate, Coordinate, Coordinate]
Direction = tuple[toml.Number, toml.Number, toml.Number]
Voxels = Annotated[toml.Count, Field(ge=4, le=512)]
Part = Annotated[toml.Number, Field(ge=0.2, lt=1.0)]


FEWEST = 10  # pores, or cracks, below which a volume does not represent its material
OFF = 0.1  # relative error of the porosity of volumes
WIDEST = 1.0 / 3.0  # largest diameter of pores and cracks over the shortest edge of such a volume


def edge_for(number: float, count: float, size: tuple[float, float, float]) -> float:
    """Mean edge, m, of a volume with ``number`` inclusions, if a volume of a size has ``count``."""
    return float(np.cbrt(number / count * np.prod(size)))


def _length(value: float) -> str:
    return readable(f"{value:.3g} m")


def read_direction(value: Direction) -> Direction:
    """Refuse a zero vector as a direction."""
    if not np.linalg.norm(value) > 0.0:
        raise ValueError(f"is a direction and must not be zero, got {list(value)}")
    return value


class Pore(toml.Settings):
    """A spherical pore of a listed volume, which continues periodically."""

    centre: Point = Field(description="Centre along x, y and z from a corner of the volume, m.")
    radius: toml.Length = Field(description="Radius, m.")


class Crack(Pore):
    """A circular flat crack of a listed volume."""

    normal: Direction = Field(description="Normal of the crack, of any length.")

    _point = field_validator("normal")(read_direction)


LARGEST_SPREAD = 2.0  # of radii: 95 % are between a fiftieth and fifty times the median


class RecipeSettings(toml.Settings):
    """Statistics of random volumes."""

    porosity: toml.Factor = Field(0.0, description="Volume fraction of spherical pores.")
    pore_radius: toml.Length | None = Field(None, description="Median radius of the pores, m.")
    pore_spread: toml.Factor = Field(0.0, le=LARGEST_SPREAD)
    """Standard deviation of the logarithm of their radii."""
    overlap: bool = False
    """Whether pores may overlap, as they must above a porosity of about .38."""
    crack_density: toml.Factor = 0.0
    """Number of circular cracks times mean cubed radius, over the volume."""
    crack_radius: toml.Length | None = Field(None, description="Median radius of the cracks, m.")
    crack_spread: toml.Factor = Field(0.0, le=LARGEST_SPREAD)
    """Standard deviation of the logarithm of their radii."""
    crack_normal: Direction | None = None
    """Normal of all cracks; evenly distributed directions if not given."""
    realisations: Annotated[toml.Positive, toml.at_most(3)] = 6
    """Number of volumes of every size."""
    seed: toml.Natural = Field(0, description="Seed of the first volume; volume k has seed + k.")

    @field_validator("crack_normal")
    @classmethod
    def _point(cls, value: Direction | None) -> Direction | None:
        return None if value is None else read_direction(value)

    def _faults(self) -> Iterator[str]:
        for share, radius in (("porosity", "pore_radius"), ("crack_density", "crack_radius")):
            if bool(getattr(self, share)) != (getattr(self, radius) is not None):
                yield f"{share} and {radius} belong together; give both or neither"
        if not self.porosity and not self.crack_density:
            yield "has neither porosity nor crack_density, so the solid has no pores or cracks"
        if self.porosity >= 1.0:
            yield f"porosity must be below 1, got {self.porosity:g}"

    def counts(self, size: tuple[float, float, float]) -> dict[str, float]:
        """Return the mean numbers of pores and cracks in a volume of a size, m."""
        volume, counts = float(np.prod(size)), {}
        if self.pore_radius is not None:  # of log-normal radii
            pore = 4.0 / 3.0 * np.pi * self.pore_radius**3 * np.exp(4.5 * self.pore_spread**2)
            share = -np.log(1.0 - self.porosity) if self.overlap else self.porosity
            counts["pores"] = float(share * volume / pore)
        if self.crack_radius is not None:
            crack = self.crack_radius**3 * np.exp(4.5 * self.crack_spread**2)
            counts["cracks"] = float(self.crack_density * volume / crack)
        return counts

    def size_faults(self, size: tuple[float, float, float]) -> Iterator[str]:
        """Report a volume that is too small, or has too many pores and cracks."""
        widest = {"pores": self.pore_radius, "cracks": self.crack_radius}
        for name, count in self.counts(size).items():
            across = 2.0 * (widest[name] or 0.0)
            enough = _length(edge_for(FEWEST, count, size))
            if across > min(size):
                yield (
                    f"{name} {_length(across)} across do not fit into a volume with a shortest "
                    f"edge of {_length(min(size))}; {FEWEST} of them need edges of about {enough}"
                )
            if count < 1.0:
                yield (
                    f"a volume has {count:.2g} {name} in the mean, fewer than one, and a volume "
                    f"with one has {1.0 / count:.3g} times the given density; {FEWEST} of them "
                    f"need edges of about {enough}"
                )
        if not (total := sum(self.counts(size).values())) <= MOST:
            yield (
                f"size holds {total:.3g} pores and cracks of [rve.recipe], more than {MOST:g}; "
                f"give a smaller size, or larger radii"
            )

    def build(self) -> Recipe:
        """Return the recipe."""
        options = self.model_dump(exclude={"realisations", "seed"}, exclude_none=True)
        return Recipe(**options)


class ImageStack(toml.Settings):
    """A binary image of a volume from tomography."""

    file: Path
    """TIFF file of many pages, or folder of TIFF slices, with only two values."""
    void_value: toml.Number = Field(0.0, description="Value of voxels without material.")
    voxel_size: toml.Length | tuple[toml.Length, toml.Length, toml.Length] | None = None
    """Edge of cubic voxels, or edges along x, y and z, m; from the file if not given."""

    def read(self) -> VoxelImage:
        """Read the image."""
        return read_images(self.file, void_value=self.void_value, voxel_size=self.voxel_size)


class RveSettings(toml.Settings):
    """A representative volume of a solid with pores and cracks.

    They come from a random recipe, from lists, or from an image.
    """

    youngs_modulus: toml.Pressure = Field(description="Young's modulus of the solid, Pa.")
    poissons_ratio: toml.Ratio = Field(description="Poisson's ratio of the solid.")
    size: tuple[toml.Length, toml.Length, toml.Length] | None = None
    """Lengths along x, y and z, m, or the edge of a cube; not for an image."""
    recipe: RecipeSettings | None = None
    pores: tuple[Pore, ...] = ()
    cracks: tuple[Crack, ...] = ()
    image: ImageStack | None = None
    voxels: Annotated[Voxels, toml.at_most(24)] = 48
    """Voxels along the longest edge, for the stiffness; a crack is a voxel thick."""
    parts: toml.Rising[Part] = (0.5,)
    """Sizes of smaller volumes over `size`, rising, of the size study."""
    level: Annotated[toml.Natural, Field(le=4), toml.at_most(1)] = 2
    """Refinement of the sphere of normals: 1, 2, 3 give about 30, 90, 330."""
    sections: Annotated[toml.Positive, toml.at_most(17)] = 33
    """Plane sections for each normal."""
    slab: Annotated[Coordinate, Field(ge=0.0)] = 0.0
    """Thickness about a section in which cracks count, m; with 0 only cracks cut by the section
    count."""
    accept: Annotated[toml.Number, Field(gt=0.0, lt=1.0)] = 0.05
    """Largest difference of the bounds, and largest scatter, of a representative volume, relative
    to its stiffness."""

    @model_validator(mode="before")
    @classmethod
    def _refuse_meshes(cls, table: object) -> object:
        if isinstance(table, dict) and "element" in table:
            raise ValueError(
                "element is no longer a key, as volumes have voxels in place of a mesh; write "
                "voxels, their number along the longest edge, at least ten across a pore or crack"
            )
        return table

    @field_validator("size", mode="before")
    @classmethod
    def _read_size(cls, value: object) -> object:
        return (value,) * 3 if isinstance(value, str) else value

    def _faults(self) -> Iterator[str]:
        kinds = {
            "recipe": self.recipe is not None,
            "pores or cracks": bool(self.pores or self.cracks),
            "image": self.image is not None,
        }
        given = [name for name, there in kinds.items() if there]
        if len(given) != 1:
            yield (
                f"takes either [rve.recipe], a list of pores and cracks, or [rve.image], got "
                f"{' and '.join(given) or 'none of them'}"
            )
        if (self.size is None) != (self.image is not None):
            yield (
                "size is given by the voxels of an image; leave it out"
                if self.size
                else "size is missing"
            )
        if self.recipe is not None and self.size is not None:
            yield from self.recipe.size_faults(self.size)

    @property
    def grid(self) -> tuple[int, int, int]:
        """Voxels along x, y and z, for an image as in its file."""
        if self.size is None:
            assert self.image is not None
            x, y, z = self.image.read().void.shape
            return x, y, z
        longest = max(self.size)
        x, y, z = (max(1, round(self.voxels * edge / longest)) for edge in self.size)
        return x, y, z

    def first(self) -> Volume:
        """Return the first representative volume."""
        return self.volumes(1.0)[0]

    def volumes(self, share: float) -> list[Volume]:
        """Return the volumes of a size: drawn by the recipe, or cut from the corners."""
        if self.recipe is not None:
            assert self.size is not None
            # smaller and larger volumes have different seeds
            seed = self.recipe.seed + round(1e6 * (1.0 - share))
            x, y, z = (
                max(1, round(share * n)) / n * edge  # of whole voxels
                for n, edge in zip(self.grid, self.size, strict=True)
            )
            recipe = self.recipe.build()
            try:
                return [recipe.draw((x, y, z), seed + k) for k in range(self.recipe.realisations)]
            except CaseError as error:
                raise CaseError(f"[rve.recipe] {error}") from error
        # an image without floating solid
        image = self.image and self.image.read().without_floating()
        whole: Volume = image or self._listed()
        if share == 1.0:
            return [whole]
        return [whole.window(share, corner) for corner in product((0, 1), repeat=3)]

    def _listed(self) -> Cavities:
        """Return the volume of the lists."""
        assert self.size is not None
        bodies: list[CavityShapes] = []
        if self.pores:
            radii = np.array([pore.radius for pore in self.pores])
            bodies.append(spheres(np.array([pore.centre for pore in self.pores]), radii))
        if self.cracks:
            centres, normals = (
                np.array([getattr(crack, name) for crack in self.cracks])
                for name in ("centre", "normal")
            )
            radii = np.array([crack.radius for crack in self.cracks])
            bodies.append(penny_cracks(centres, normals, radii))
        return Cavities(self.size, bodies)

    @property
    def counts(self) -> dict[str, float]:
        """Number of pores and cracks of the largest volumes; unknown for an image."""
        if self.recipe is not None:
            assert self.size is not None
            return self.recipe.counts(self.size)
        listed = {"pores": float(len(self.pores)), "cracks": float(len(self.cracks))}
        return {name: count for name, count in listed.items() if count}

    def limits(self, porosity: float) -> Iterator[str]:
        """Report why volumes with a mean porosity do not represent their material."""
        if self.size is None:
            return
        recipe = self.recipe
        radii = {
            "pores": [pore.radius for pore in self.pores]
            + [(recipe and recipe.pore_radius) or 0.0],
            "cracks": [crack.radius for crack in self.cracks]
            + [(recipe and recipe.crack_radius) or 0.0],
        }
        for name, count in self.counts.items():
            share = 2.0 * max(radii[name]) / min(self.size)
            if count < FEWEST:
                edge = _length(edge_for(FEWEST, count, self.size))
                yield f"a volume has {count:.2g} {name}, and {FEWEST} need edges of about {edge}"
            elif share > WIDEST:
                yield f"{name} are {share:.2g} of the shortest edge across, more than a third"
        excess = porosity - recipe.porosity if recipe is not None else 0.0
        if recipe is None or (excess > 0.0 and recipe.crack_density):
            return  # the voxels of flat cracks count as pores
        if abs(excess) > OFF * recipe.porosity:
            yield (
                f"the volumes have a porosity of {100.0 * porosity:.3g} % instead of "
                f"{100.0 * recipe.porosity:.3g} %"
            )

    @property
    def smallest(self) -> float:
        """Smallest median diameter of pores, m; infinite without pores, or in an image."""
        radii = [pore.radius for pore in self.pores]
        radii += [self.recipe.pore_radius] if self.recipe and self.recipe.pore_radius else []
        return 2.0 * min(radii, default=np.inf)

    def jobs(self) -> Iterator[tuple[float, Volume]]:
        """Yield all volumes with their size over the representative volume, the largest first."""
        for share in (1.0, *self.parts[::-1]):
            yield from ((share, volume) for volume in self.volumes(share))

    def voxels_of(self, volume: Volume) -> int:
        """Voxels along the longest edge of a volume; all voxels have the same size."""
        return round(max(volume.size) / (max(self.size) / self.voxels)) if self.size else 0

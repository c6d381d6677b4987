"""Bodies with the stiffness of a representative volume, and errors of this stiffness."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from multiscale.fe.faces import face_of
from multiscale.laws.bulk import AnisotropicElastic
from multiscale.pipeline.tables.meshed_bodies import MeshedBody
from multiscale.pipeline.tables.structure_kind import Face
from multiscale.schema import Dataset
from multiscale.units import readable
from multiscale.upscaling import Uncertainty
from multiscale.upscaling.budget import FEW_CELLS

if TYPE_CHECKING:
    from skfem import Mesh

FEWEST_ACROSS = 3.0  # representative volumes across a body, from which on it is a continuum


@dataclass(frozen=True)
class SurfaceDamage:
    """Damage of sections near a face, and the half-width of its interval."""

    mean: float
    half_width: float


class PorousBody(MeshedBody):
    """A body with its representative volume; no case has such a table."""

    plain: MeshedBody  # without its volume
    volume_data: Any  # a dataset that follows ``RVE``
    factor: float = 1.0  # by which the stiffness is multiplied

    @classmethod
    def of(cls, body: MeshedBody, rve: Dataset) -> "PorousBody":
        """Return a body with its representative volume and the Poisson's ratio of the solid."""
        ratio = float(rve.attrs["poissons_ratio"])
        volume = {"poissons_ratio": ratio, "volume_data": rve, "plain": body}
        return cls.model_construct(**dict(body) | volume)

    def load(self) -> "Mesh":
        """Read or build the mesh."""
        return self.plain.load()

    def coarsened(self) -> "PorousBody | None":
        """Return the same body with larger elements, if possible."""
        plain = self.plain.coarsened()
        return None if plain is None else self.model_copy(update={"plain": plain})

    def elasticity(self) -> AnisotropicElastic:
        """Return the law of the volume, rotated to its axes."""
        C = self.factor * (1.0 - self.damage) * self.volume_data["stiffness"].to_numpy()
        return AnisotropicElastic(C).turned(self.axes)

    @property
    def worst_damage(self) -> float:
        """Damage by the worst section of the volume and by the key ``damage``."""
        return 1.0 - (1.0 - self.damage) * (1.0 - float(self.volume_data["damage"].max()))

    @property
    def box(self) -> np.ndarray:
        """Size of the volume, m."""
        return np.asarray(self.volume_data["box_size"].to_numpy())

    def error(self, mesh: "Mesh") -> Uncertainty:
        """Return the errors of the stiffness of a body, the largest of all directions."""
        rve = self.volume_data
        sampling, sides, elements = rve["modulus_error"].max("direction").to_numpy()
        scatter = float(rve["scatter"].max())
        count = float(_volume(mesh) / np.prod(self.box))
        return Uncertainty(
            name=f"volume of {self.name}",
            half_width={
                "sampling": sampling,
                "micro discretisation": elements,
                "scale separation": sides,
                FEW_CELLS: 2.0 * scatter / np.sqrt(count),
            },
            how={
                "sampling": "scatter of the representative volumes",
                "micro discretisation": "the stiffness of volumes on elements twice as large",
                "scale separation": "bounds by traction and displacement sides",
                FEW_CELLS: f"scatter of single volumes; the body contains {count:.3g}",
            },
        )

    def cautions(self, mesh: "Mesh") -> list[str]:
        """Report a body that is too small for its volume."""
        extent, edge = float(np.ptp(mesh.p, axis=1).min()), float(self.box.max())
        if extent > FEWEST_ACROSS * edge:
            return []
        comparison = "is larger than" if edge > extent else "is hardly smaller than"
        return [
            f"the representative volume of {self.name} {comparison} the body is thick, "
            f"{readable(f'{edge:.3g} m')} against {readable(f'{extent:.3g} m')}: scales do not "
            f"separate, and the stiffness of a continuum may not hold"
        ]

    def surface_damage(self, mesh: "Mesh", boundary: str) -> SurfaceDamage:
        """Return the mean damage of sections along a face, which may be at any section."""
        face, rve = Face.at(mesh, boundary), self.volume_data
        at = int(np.argmax(np.abs(rve["normal"].to_numpy() @ (self.axes.T @ face.normal))))
        whole = rve["share"].to_numpy() == 1.0
        mean, low, high = (
            float(rve[f"{name}_damage"].to_numpy()[whole, at].mean())
            for name in ("mean", "low", "high")
        )
        section = float(np.prod(self.box)) ** (2.0 / 3.0)
        return SurfaceDamage(mean, 0.5 * (high - low) * np.sqrt(section / face.area))


def _volume(mesh: "Mesh") -> float:
    """Volume of a mesh of straight elements, m³, by the divergence theorem on its faces."""
    named = mesh.with_boundaries({"all of it": mesh.boundary_facets()})
    face = face_of(named, "all of it")
    x = face.position[face.facets]
    return float(np.sum(face.normals * x.mean(axis=1)) / 3.0)

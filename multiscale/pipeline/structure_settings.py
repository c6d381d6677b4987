"""What a case that begins at a structure may say, and what its tables may say together."""

from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar, Self, get_args

from pydantic import Field, model_validator

from multiscale.errors import CaseError
from multiscale.pipeline.body_settings import LapJoint, Plate, StackedBlocks
from multiscale.pipeline.grain_settings import (
    Biaxial,
    ColumnCollapse,
    Deposit,
    GrainSettings,
    Motion,
    ShearCell,
    Silo,
)
from multiscale.pipeline.joint_settings import JointLawSettings, Loading, Substructures
from multiscale.pipeline.link_settings import (
    CableNet,
    Dynamics,
    LinkMesh,
    LinkTable,
    Statics,
    TensegrityGrid,
)
from multiscale.pipeline.toml_model import Settings

__all__ = ["KINDS", "StructureCase"]

Structure = (
    TensegrityGrid
    | CableNet
    | LinkTable
    | LinkMesh
    | Plate
    | StackedBlocks
    | LapJoint
    | Deposit
    | Silo
    | ColumnCollapse
    | ShearCell
    | Biaxial
)
"""All kinds of structures."""

KINDS: dict[str, type[Settings]] = {
    get_args(kind.model_fields["kind"].annotation)[0]: kind for kind in get_args(Structure)
}
"""Every kind by its name in files."""


class StructureCase(Settings):
    """One question to a structure of bars and cables, of elastic bodies, or of grains.

    Bars and cables take either statics or dynamics, a plate statics, blocks and a lap joint both
    joint and loading, grains both grains and motion; substructures cut a tensegrity grid or bodies.
    """

    title: str = Field(description="Title of tables and datasets.")
    structure: Structure = Field(discriminator="kind")
    statics: Statics | None = None
    dynamics: Dynamics | None = None
    joint: JointLawSettings | None = None
    loading: Loading | None = None
    substructures: Substructures | None = None
    grains: GrainSettings | None = None
    motion: Motion | None = None

    describes: ClassVar[str] = "a structure"
    accuracy: ClassVar[None] = None
    """No planner: it chooses cells of joints alone."""
    realisations: ClassVar[int] = 0
    """No cells."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        kind = self.structure
        given = super().tables - {"title", "structure", "substructures"}
        if given not in [set(tables) for tables in kind.asks]:
            asked = " or ".join(_list(tables) for tables in kind.asks)
            raise ValueError(
                f"a structure of kind {kind.kind!r} takes {asked}, got {_list(sorted(given))}"
            )
        if self.substructures is not None and not kind.may_be_cut:
            raise ValueError(
                f"[substructures] cut tensegrity grids, plates, blocks and lap joints, not a "
                f"structure of kind {kind.kind!r}"
            )
        kind.check(self)
        return self

    @property
    def tables(self) -> frozenset[str]:
        """Tables that are given, and the stages that the structure and its cut ask for."""
        condensed = {"homogenise"} if self.cut.homogenise else set()
        return super().tables | {self.structure.stage} | condensed

    @property
    def cut(self) -> Substructures:
        """How the structure is cut; in one part if it is not."""
        return self.substructures or Substructures()

    def quick(self) -> Self:
        """Return the same case with at most 4 x 4 modules or meshes, few elements, grains, steps.

        A structure from a file stays as it is.
        """
        parts = (self.loading, self.substructures, self.grains, self.motion)
        names = ("loading", "substructures", "grains", "motion")
        changes = {name: part and part.quick() for name, part in zip(names, parts, strict=True)}
        small = self.model_copy(update=changes)
        small = small.model_copy(update={"structure": self.structure.quick(small)})
        return small.model_copy(update={"title": f"{self.title} (quick)"})

    def with_law(self, law: Path) -> Self:
        """Return the same case with another law of its joints.

        Raises
        ------
        CaseError
            If it has none.
        """
        if self.joint is None:
            raise CaseError(
                f"{self.title}: the structure has no joint that the law {law} could be of"
            )
        joint = self.joint.model_copy(update={"law": law})
        return self.model_copy(update={"joint": joint})

    @property
    def scope(self) -> str:
        """What belongs to one run folder, in a few words."""
        return f"a structure of kind {self.structure.kind!r}"

    def identity(self) -> str:
        """Checksum of the structure, to which one run folder belongs."""
        return self.checksum(include={"structure", "grains"})


def _list(tables: Iterable[str]) -> str:
    """Name tables as files do."""
    return " and ".join(f"[{name}]" for name in tables) or "none of them"

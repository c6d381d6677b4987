"""What every kind of structure says of itself."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar, Self

from multiscale.errors import CaseError
from multiscale.macro import substructures
from multiscale.pipeline.toml_model import Settings

if TYPE_CHECKING:
    from multiscale.pipeline.settings import Case
    from multiscale.pipeline.stage import Datasets, Job

__all__ = ["StructureKind"]


class StructureKind(Settings):
    """The table ``[structure]`` of a case; a kind also knows how it is built, by ``build``.

    Attributes
    ----------
    stage : str, name of the stage that solves it
    asks : tuple of tuple of str, the tables that go with it: all of one of these sets
    models : mapping of str to type, models of those tables whose keys depend on the kind
    may_be_cut : bool, whether ``[substructures]`` may cut it
    may_tire : bool, whether ``[fatigue]`` and ``[growth]`` may follow its elements
    of_bodies : bool, whether it is made of the materials of ``[body_1]`` and ``[body_2]``
    """

    stage: ClassVar[str]
    asks: ClassVar[tuple[tuple[str, ...], ...]]
    models: ClassVar[Mapping[str, type[Settings]]] = {}
    may_be_cut: ClassVar[bool] = False
    may_tire: ClassVar[bool] = False
    of_bodies: ClassVar[bool] = False

    @property
    def interface_width(self) -> float | None:
        """Edge of an interface under even pressure, m, if that is what the structure is."""
        return None

    def check(self, case: "Case") -> None:
        """Refuse what the other tables of the case say and the structure cannot do.

        Raises
        ------
        ValueError
            With a sentence.
        """

    def cut(self, case: "Case", found: "Datasets", job: "Job") -> "substructures.CutProblem":
        """Cut the structure into its substructures, if it may be cut."""
        raise CaseError(f"substructures do not cut a structure of stage {self.stage}")

    def quick(self, case: "Case") -> Self:
        """Return the same structure, smaller; the other tables of the case are quick already."""
        return self

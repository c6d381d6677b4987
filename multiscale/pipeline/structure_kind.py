"""What every kind of structure says of itself."""

from typing import TYPE_CHECKING, ClassVar, Self

from multiscale.errors import CaseError
from multiscale.macro.substructures import CutProblem
from multiscale.pipeline.toml_model import Settings

if TYPE_CHECKING:
    from multiscale.pipeline.structure_settings import StructureCase

__all__ = ["StructureKind"]


class StructureKind(Settings):
    """The table ``[structure]`` of a case; a kind also knows how it is built, by ``build``.

    Attributes
    ----------
    stage : str, name of the stage that solves it
    asks : tuple of tuple of str, the tables that go with it: all of one of these sets
    may_be_cut : bool, whether ``[substructures]`` may cut it
    """

    stage: ClassVar[str]
    asks: ClassVar[tuple[tuple[str, ...], ...]]
    may_be_cut: ClassVar[bool] = False

    def check(self, case: "StructureCase") -> None:
        """Refuse what the other tables of the case say and the structure cannot do.

        Raises
        ------
        ValueError
            With a sentence.
        """

    def cut(self, case: "StructureCase") -> CutProblem:
        """Cut the structure into its substructures, if it may be cut."""
        raise CaseError(f"substructures do not cut a structure of stage {self.stage}")

    def quick(self, case: "StructureCase") -> Self:
        """Return the same structure, smaller; the other tables of the case are quick already."""
        return self

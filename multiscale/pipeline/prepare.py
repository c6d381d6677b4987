"""What is refused of a case before any of its stages is run."""

from multiscale.errors import CaseError
from multiscale.pipeline.case import taken_law
from multiscale.pipeline.joint_settings import LawSource
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.structure_kind import OF_CELLS, Pressed, Range, tell_far
from multiscale.upscaling import law_from_dataset, read_law

__all__ = ["prepare"]


def prepare(case: Case) -> None:
    """Refuse a case for its files, and for loads that are far outside the data of its laws."""
    for stage in stages_of(case.tables):
        stage.prepare(case)
    if case.structure is not None and not case.extrapolate:
        for pressed in case.structure.pressed(case):
            if said := tell_far(pressed, *_data_of(case, pressed)):
                raise CaseError(f"{case.title}: {said}")


def _data_of(case: Case, pressed: Pressed) -> tuple[Range, str, str]:
    """Pressures of the law of an interface, Pa, where they stand, and what to change."""
    if pressed.stated is not None:
        return pressed.stated, "stated by the case", "state a law for such pressures"
    if pressed.law is None and case.has_cells:
        return (case.micro.pressures[0], case.micro.pressures[-1]), *OF_CELLS
    remedy = "take a law of such pressures, or set extrapolate = true in [interface]"
    file = pressed.law or (case.interface or LawSource()).source
    if file.suffix == ".toml":
        _, other = taken_law(file, quick=False)
        return (other.micro.pressures[0], other.micro.pressures[-1]), file.name, remedy
    return law_from_dataset(read_law(file)).pressure_range, file.name, remedy

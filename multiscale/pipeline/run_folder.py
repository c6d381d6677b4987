"""A run folder: its case, and the check of its datasets against the case."""

from collections.abc import Mapping
from pathlib import Path
from shutil import rmtree

from multiscale.errors import CaseError, MultiscaleError, NewerSchemaError, SchemaError
from multiscale.io import open_dataset, read_text, remove, write_bytes
from multiscale.pipeline.case import load_case
from multiscale.pipeline.stage import Shown, Stage
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.sweep_points import POINTS
from multiscale.pipeline.tables.settings import Case
from multiscale.pipeline.tables.toml_model import read_toml
from multiscale.schema import Dataset

MOST_KEYS = 4  # keys that a message names


def claim_folder(out: Path, case: Case, *, force: bool = False) -> None:
    """Write the case into its run folder, unless the folder has results of another case."""
    file = out / "case.toml"
    results = any(out.rglob("*.nc"))
    if file.exists() and results:
        if "sweep" in read_toml(file):
            raise CaseError(f"{out} holds a sweep; choose another folder for a single run")
        if difference := _difference(file, case):
            raise CaseError(
                f"{out} holds {difference}; choose another folder, or delete this folder"
            )
    if results:
        stages = stages_of(case.tables)
        stale = [force or read_up_to_date(stage, case, out) is None for stage in stages]
        for stage, is_stale in zip(stages, stale, strict=True):
            if is_stale:
                remove(out / stage.file)
            for name in stage.folders if force else ():
                rmtree(out / name, ignore_errors=True)
    write_bytes(file, case.to_toml().encode())


def require_claimed(out: Path, case: Case) -> None:
    """Refuse a folder that another run has taken since this run began."""
    file = out / "case.toml"
    if file.exists() and read_text(file) != case.to_toml():
        raise CaseError(
            f"{out}: another run has written its case into this folder since the start; delete the "
            f"folder, and give each run a separate folder"
        )


def _difference(file: Path, case: Case) -> str:
    """Report the difference of the case of a folder; empty if its results belong to this case."""
    try:
        other = load_case(file)
        if other.identity() == case.identity():
            return ""
    except MultiscaleError as error:  # of another version, or its files have moved
        return f"another run, with a case that can no longer be read ({error})"
    for whole, part, text in (
        (other, case, "the cells of this case too, which --from structure leaves out"),
        (case, other, "the run of this case --from structure, without its cells"),
    ):
        has_part = whole.has_cells and whole.structure is not None and whole.rve is None
        if has_part and whole.from_structure(None).identity() == part.identity():
            return text
    if other.scope != case.scope:
        return f"another run, {other.title!r}, of {other.scope}"
    ours, theirs = _keys(case), _keys(other)
    keys = [key for key in dict.fromkeys([*theirs, *ours]) if theirs.get(key) != ours.get(key)]
    more = f" and {len(keys) - MOST_KEYS} more" if len(keys) > MOST_KEYS else ""
    where = ", ".join(keys[:MOST_KEYS]) or "the files named in it"
    return f"another run, {other.title!r}, of {other.scope}, which differs in {where}{more}"


def _keys(case: Case) -> dict[str, object]:
    return {
        f"{table}.{key}" if key else table: inner
        for table, value in case.model_dump(exclude={"title"}, exclude_none=True).items()
        for key, inner in (value.items() if isinstance(value, dict) else [("", value)])
    }


def read_up_to_date(stage: Stage, case: Case, out: Path) -> Dataset | None:
    """Return the dataset of a stage if it is valid and computed from the same inputs."""
    try:
        stored = open_dataset(out / stage.file, stage.schema)
    except NewerSchemaError as error:
        raise SchemaError(
            f"{error}, another folder with -o, or --force, which overwrites the dataset"
        ) from error
    except SchemaError:  # missing, damaged or of an earlier version
        return None
    return stored if stored.attrs.get("identity") == stage.identity(case) else None


def is_whole(out: Path, case: Case) -> bool:
    """Whether a run folder has an up-to-date dataset of each stage of a case."""
    stages = stages_of(case.tables)
    return all(read_up_to_date(stage, case, out) is not None for stage in stages)


def open_stages(out: Path) -> dict[Shown, Dataset]:
    """Open the datasets of the stages of a finished run, or of a finished sweep."""
    file = out / "case.toml"
    if not file.exists():
        raise SchemaError(f"{out}: no results; the folder of a run has its case.toml and datasets")
    swept = "sweep" in read_toml(file)
    stages: tuple[Shown, ...] = (POINTS,) if swept else stages_of(load_case(file).tables)
    if missing := [stage.file for stage in stages if not (out / stage.file).exists()]:
        raise SchemaError(
            f"{out}: the run is not finished, as {' and '.join(missing)} "
            f"{'is' if len(missing) == 1 else 'are'} missing; run its case again in this folder, "
            f"which continues it or reports the fault"
        )
    return {stage: open_dataset(out / stage.file, stage.schema) for stage in stages}


def gather_cautions(datasets: Mapping[Shown, Dataset]) -> list[str]:
    """Return the cautions of a finished run, one sentence each."""
    cautions = [
        caution for stage, dataset in datasets.items() for caution in stage.cautions(dataset)
    ]
    return list(dict.fromkeys(cautions))  # a law repeats the cautions of its response

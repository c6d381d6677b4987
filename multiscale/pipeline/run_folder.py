"""A run folder: whose it is, and what of it still stands."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from multiscale.errors import CaseError, SchemaError
from multiscale.io import open_dataset, read_text, remove, write_bytes
from multiscale.pipeline.case import load_file
from multiscale.pipeline.settings import Case
from multiscale.pipeline.stage import Shown
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.toml_model import read_toml
from multiscale.pipeline.tyre_settings import TyreCase

if TYPE_CHECKING:
    import xarray as xr

__all__ = ["claim_folder", "list_cautions", "open_stages"]


def claim_folder(out: Path, case: Case | TyreCase) -> None:
    """Write the case into its run folder, unless it holds what another one has computed.

    A case of the same cells may differ in the rest: the cells stand, and the result of the joint
    goes, so that no report shows it beside inputs that are not its own.

    Parameters
    ----------
    out : Path
        Run folder, which exists.
    case : Case or TyreCase

    Raises
    ------
    CaseError
        If the folder holds another run, or a sweep.
    """
    if (out / "sweep.nc").exists():
        raise CaseError(f"{out} holds a sweep; choose another folder for a single run")
    file, text = out / "case.toml", case.to_toml()
    if file.exists() and any(out.rglob("*.nc")):
        other = load_file(file)
        if type(other) is not type(case) or other.identity() != case.identity():
            raise CaseError(
                f"{out} holds another run, {other.title!r} with {other.cell.points[0]} x "
                f"{other.cell.points[1]} points; choose another folder, or delete this one"
            )
        if read_text(file) != text:
            remove(out / "macro_result.nc")
    write_bytes(file, text.encode())


def open_stages(out: Path) -> "dict[Shown, xr.Dataset]":
    """Open the datasets that the stages of a finished run have left, in their order.

    Raises
    ------
    SchemaError
        If a dataset is missing or refused.
    """
    if not (out / "case.toml").exists():
        raise SchemaError(f"{out}: no results; a run leaves its case.toml and datasets")
    stages = stages_of(read_toml(out / "case.toml"))
    if not all((out / stage.file).exists() for stage in stages):
        names = ", ".join(stage.file for stage in stages)
        raise SchemaError(f"{out}: the run is not finished; a finished run leaves {names}")
    return {stage: open_dataset(out / stage.file, stage.schema) for stage in stages}


def list_cautions(found: "Mapping[Shown, xr.Dataset]") -> list[str]:
    """Return what a user should know before trusting a finished run, one sentence each."""
    cautions = [one for stage, dataset in found.items() for one in stage.cautions(dataset)]
    return list(dict.fromkeys(cautions))  # a law repeats those of its response

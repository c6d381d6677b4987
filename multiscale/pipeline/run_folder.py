"""A run folder: whose it is, and what of it still stands."""

from pathlib import Path

from multiscale.errors import CaseError
from multiscale.io import open_dataset, read_text, remove, write_bytes
from multiscale.pipeline.case import is_tyre_case, load_case, load_tyre
from multiscale.pipeline.case_slide import read_sliding
from multiscale.pipeline.settings import Case
from multiscale.pipeline.tyre_settings import TyreCase
from multiscale.schema import INTERFACE_LAW, MACRO_RESULT, MICRO_RESPONSE

__all__ = ["claim_folder", "read_cautions"]


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
        other = load_tyre(file) if is_tyre_case(file) else load_case(file)
        if type(other) is not type(case) or other.identity() != case.identity():
            raise CaseError(
                f"{out} holds another run, {other.title!r} with {other.cell.points[0]} x "
                f"{other.cell.points[1]} points; choose another folder, or delete this one"
            )
        if read_text(file) != text:
            remove(out / "macro_result.nc")
    write_bytes(file, text.encode())


def read_cautions(out: Path) -> list[str]:
    """Return what a user should know before trusting a finished run, one sentence each."""
    datasets = [
        open_dataset(out / "micro_response.nc", MICRO_RESPONSE),
        open_dataset(out / "interface_law.nc", INTERFACE_LAW),
        open_dataset(out / "macro_result.nc", MACRO_RESULT),
        read_sliding(out),
    ]
    found = [
        caution
        for dataset in datasets
        if dataset is not None
        for caution in str(dataset.attrs.get("cautions", "")).splitlines()
    ]
    return list(dict.fromkeys(found))  # a law repeats those of its response

"""Case files: found by path or name, read, and refused in sentences."""

from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any

from multiscale.errors import CaseError
from multiscale.pipeline.rough_bodies import InstrumentSurface, SyntheticSurface
from multiscale.pipeline.settings import Case
from multiscale.pipeline.toml_model import Settings, read_toml, validate
from multiscale.pipeline.tyre_settings import TyreCase

__all__ = [
    "find_case",
    "load_case",
    "load_file",
    "load_tyre",
    "read_case",
    "shipped_cases",
    "validate_case",
]


def shipped_cases() -> dict[str, Path]:
    """Return names and paths of the cases that come with the package."""
    inside = Path(str(resources.files("multiscale"))) / "microcases"
    beside = Path(str(resources.files("multiscale"))).parent / "microcases"
    folder = inside if inside.is_dir() else beside
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def find_case(case: str | Path) -> Path:
    """Return the path of a case file, or of the shipped case of that name.

    Raises
    ------
    CaseError
        If there is no such case.
    """
    shipped = shipped_cases()
    path = Path(case)
    if path.is_dir() and str(case) not in shipped:
        raise CaseError(f"{path} is a folder; give the case file in it")
    if path.suffix or path.is_file():
        return path
    if str(case) in shipped:
        return shipped[str(case)]
    close = get_close_matches(str(case), shipped, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"shipped cases: {', '.join(shipped)}"
    raise CaseError(f"no case named {str(case)!r}; {hint}")


def load_case(case: str | Path) -> Case:
    """Read a case file.

    Parameters
    ----------
    case : str or Path
        Path of a TOML file, or the name of a shipped case.

    Raises
    ------
    CaseError
        If there is no such case, or with every fault of the file, one a line.

    Examples
    --------
    >>> load_case("ground_steel").cell.points
    (128, 128)
    """
    path = find_case(case)
    content = read_case(path)
    if "sweep" in content:
        raise CaseError(f"{path}: lists values in [sweep]; load it with load_sweep")
    return validate_case(content, path)


def load_file(case: str | Path) -> Case | TyreCase:
    """Read a case file of any kind, which its tables tell; see :func:`load_case`."""
    path = find_case(case)
    return load_tyre(path) if "rubber" in read_case(path) else load_case(path)


def load_tyre(case: str | Path) -> TyreCase:
    """Read a case file of sliding rubber.

    Raises
    ------
    CaseError
        If there is no such case, or with every fault of the file, one a line.

    Examples
    --------
    >>> load_tyre("tyre_on_road").cell.points
    (128, 128)
    """
    path = find_case(case)
    return validate(TyreCase, read_case(path), path, {})


def _refuse_others(content: dict[str, Any], path: Path) -> None:
    """Refuse a file of another kind."""
    if "structure" in content:
        raise CaseError(f"{path}: describes a structure, not a joint; use multiscale macro")
    if "rubber" in content:
        raise CaseError(
            f"{path}: describes rubber that slides on a road, not a joint; use multiscale run, or "
            f"load_tyre and run"
        )


def read_case(path: Path) -> dict[str, Any]:
    """Read a case file without checking it; paths of surfaces become absolute."""
    content = read_toml(path)
    for name in ("body_1", "body_2"):
        surface = (
            content.get(name, {}).get("surface") if isinstance(content.get(name), dict) else None
        )
        if isinstance(surface, dict) and isinstance(surface.get("file"), str):
            surface["file"] = str(path.parent.resolve() / surface["file"])
    return content


def validate_case(content: dict[str, Any], path: Path) -> Case:
    """Turn the content of a case file into settings."""
    _refuse_others(content, path)
    kinds: dict[str, type[Settings]] = {
        "synthetic": SyntheticSurface,
        "instrument": InstrumentSurface,
    }
    return validate(Case, content, path, kinds)

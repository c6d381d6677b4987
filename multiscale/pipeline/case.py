"""Case files: found by path or name, read, and refused in sentences."""

from collections.abc import Sequence
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from multiscale.errors import CaseError
from multiscale.pipeline.rough_bodies import InstrumentSurface, SyntheticSurface
from multiscale.pipeline.settings import Case
from multiscale.pipeline.structure_settings import KINDS, StructureCase
from multiscale.pipeline.toml_model import Settings, read_toml, validate
from multiscale.pipeline.tyre_settings import TyreCase

__all__ = [
    "AnyCase",
    "find_case",
    "load_case",
    "load_case_of",
    "read_case",
    "shipped_cases",
    "validate_case",
]

AnyCase: TypeAlias = Case | TyreCase | StructureCase
Kind = TypeVar("Kind", Case, TyreCase, StructureCase)

BEGINS: dict[str, type[AnyCase]] = {"structure": StructureCase, "rubber": TyreCase}
"""Kinds of cases by the table that only they have; all others are joints."""

TAGS: dict[str, type[Settings]] = {
    "synthetic": SyntheticSurface,
    "instrument": InstrumentSurface,
    **KINDS,
}
"""Tables that come in several kinds."""

FILES = (
    ("body_1", "surface", "file"),
    ("body_2", "surface", "file"),
    *(("structure", key) for key in ("nodes", "links", "file", "stiffness")),
    ("joint", "law"),
)
"""Keys that name files."""

RENAMINGS: dict[tuple[str, ...], str] = {
    ("motion", "domains"): "grains are not cut into domains; delete the key",
}
"""Keys of files of earlier versions, and what to write instead."""


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


def load_case(case: str | Path) -> AnyCase:
    """Read a case file of any kind, which its tables tell.

    Parameters
    ----------
    case : str or Path
        Path of a TOML file, or the name of a shipped case; files that it names are looked for
        beside it.

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


def load_case_of(kind: type[Kind], case: str | Path) -> Kind:
    """Read a case file of one kind; see :func:`load_case`.

    Raises
    ------
    CaseError
        Also if it is of another kind.
    """
    found = load_case(case)
    if not isinstance(found, kind):
        raise CaseError(
            f"{case}: describes {found.describes}, not {kind.describes}; use multiscale run"
        )
    return found


def read_case(path: Path) -> dict[str, Any]:
    """Read a case file without checking it; paths of other files become absolute.

    Raises
    ------
    CaseError
        If it cannot be read, or says what only an earlier version knew.
    """
    content = read_toml(path)
    for (*tables, key), instead in RENAMINGS.items():
        if key in _table(content, tables):
            raise CaseError(f"{path}: [{'.'.join(tables)}] has no key {key!r} any more: {instead}")
    for *tables, key in FILES:
        table = _table(content, tables)
        if isinstance(table.get(key), str):
            table[key] = str(path.parent.resolve() / table[key])
    return content


def _table(content: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Return the table under some names, an empty one if there is none."""
    for name in names:
        inner = content.get(name)
        content = inner if isinstance(inner, dict) else {}
    return content


def validate_case(content: dict[str, Any], path: Path) -> AnyCase:
    """Turn the content of a case file into settings."""
    kind = next((kind for table, kind in BEGINS.items() if table in content), Case)
    return validate(kind, content, path, TAGS)

"""Case files: found by path or name, read, and refused in sentences."""

from collections.abc import Sequence
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any, TypeAlias
from warnings import warn

from multiscale.errors import CaseError
from multiscale.pipeline.rough_bodies import InstrumentSurface, SyntheticSurface
from multiscale.pipeline.settings import KINDS, Case
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.toml_model import Settings, list_tables, read_toml, validate
from multiscale.pipeline.tyre_settings import TyreCase
from multiscale.schema import INTERFACE_LAW

__all__ = [
    "AnyCase",
    "find_case",
    "load_case",
    "read_case",
    "shipped_cases",
    "validate_case",
]

AnyCase: TypeAlias = Case | TyreCase
"""A chain, or rubber on a road, whose cells and law have other keys in tables of the same names."""

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
    *(("structure", "bodies", key) for key in ("mesh", "coarser", "stiffness")),
    ("structure", "interfaces", "law"),
    *(("interface", key) for key in ("law", "damage_file")),
    ("cell", "mesh"),
)
"""Keys that name files, of tables and of lists of tables."""

LAWS = ("interfaces", "interface")
"""Tables whose law may also be the folder of a run, or a shipped case."""

RENAMINGS: dict[tuple[str, str], tuple[str, str]] = {
    ("joint", "height"): ("structure", "height"),
    ("joint", "width"): ("structure", "width"),
    ("joint", "preloads"): ("statics", "preloads"),
    ("joint", "law"): ("interface", "law"),
    ("joint", "friction"): ("interface", "friction"),
    ("joint", "stiffness_ratio"): ("interface", "stiffness_ratio"),
    ("joint", "damage"): ("interface", "damage"),
    ("joint", "extrapolate"): ("interface", "extrapolate"),
    ("loading", "preloads"): ("statics", "preloads"),
    ("loading", "shear"): ("cycles", "shear"),
    ("loading", "cycles"): ("cycles", "cycles"),
    ("loading", "steps"): ("cycles", "steps"),
}
"""Keys of files of earlier versions by their tables, and their places now."""

RENAMED = tuple(dict.fromkeys(table for table, _ in RENAMINGS))
"""Tables that only files of earlier versions have."""

GONE: dict[tuple[str, str], str] = {
    ("motion", "domains"): "grains are not cut into domains; delete the key",
}
"""Keys of files of earlier versions that mean nothing now, and what to do."""


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


def read_case(path: Path) -> dict[str, Any]:
    """Read a case file without checking it; paths of other files become absolute.

    Raises
    ------
    CaseError
        If it cannot be read, or says what only an earlier version knew.
    """
    content = _renamed(read_toml(path), path)
    for (table, key), instead in GONE.items():
        if key in _table(content, (table,)):
            raise CaseError(f"{path}: [{table}] has no key {key!r} any more: {instead}")
    for *tables, key in FILES:
        for named in _tables(content, tables):
            if isinstance(named.get(key), str):
                of_law = tables[-1] in LAWS
                named[key] = str(_find_file(path.parent.resolve() / named[key], of_law))
    return content


def _tables(content: dict[str, Any], names: Sequence[str]) -> list[dict[str, Any]]:
    """Return all tables under some names, of which the last may be a list of tables."""
    outer = _table(content, names[:-1])
    found = outer.get(names[-1])
    return [one for one in (found if isinstance(found, list) else [found]) if isinstance(one, dict)]


def _find_file(file: Path, of_law: bool) -> Path:
    """Return the file itself; of laws, the law in the folder of a run, or a shipped case."""
    if of_law and file.is_dir():
        return file / f"{INTERFACE_LAW.name}.nc"
    if of_law and not file.exists():
        return shipped_cases().get(file.name, file)
    return file


def _renamed(content: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the content of a file, and of its sweep, with keys of earlier versions in new places.

    Raises
    ------
    CaseError
        If old and new names stand together, or a key of an old table has no new place.
    """
    new = _moved(content, path)
    if sweep := _table(content, ("sweep",)):
        new["sweep"] = _moved(sweep, path)
    if new == content:
        return content
    if "structure" in new.keys() - content.keys():
        new["structure"] = {"kind": "blocks"} | new["structure"]
    if _table(new, ("cycles",)).get("cycles") == 0:  # as a run without cycles has written it
        del new["cycles"]
    old = list_tables(name for name in RENAMED if name in content or name in sweep)
    now = list_tables(
        dict.fromkeys(
            place
            for (table, key), (place, _) in RENAMINGS.items()
            if key in _table(content, (table,)) or key in _table(sweep, (table,))
        )
    )
    warn(
        f"{path}: what earlier versions wrote as {old} is read as {now}; write {now} instead",
        FutureWarning,
        stacklevel=2,
    )
    return new


def _moved(content: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return tables with the keys of earlier versions in their new tables."""
    old = {name: table for name, table in content.items() if name in RENAMED}
    old = {name: table for name, table in old.items() if isinstance(table, dict)}
    new = {name: table for name, table in content.items() if name not in old}
    for name, table in old.items():
        for key, value in table.items():
            if (name, key) not in RENAMINGS:
                known = ", ".join(one for at, one in RENAMINGS if at == name)
                close = get_close_matches(key, known.split(", "), n=1)
                hint = f"did you mean {close[0]!r}?" if close else f"known keys: {known}"
                raise CaseError(f"{path}: [{name}] of earlier versions has no key {key!r}; {hint}")
            place, renamed = RENAMINGS[name, key]
            if place in content:
                raise CaseError(
                    f"{path}: [{name}] {key} is now [{place}] {renamed}, and the file has "
                    f"[{place}] as well; move the keys of [{name}] to their new places"
                )
            new.setdefault(place, {})[renamed] = value
    return new


def _table(content: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    """Return the table under some names, an empty one if there is none."""
    for name in names:
        inner = content.get(name)
        content = inner if isinstance(inner, dict) else {}
    return content


def validate_case(content: dict[str, Any], path: Path) -> AnyCase:
    """Turn the content of a case file into settings.

    Raises
    ------
    CaseError
        With every fault of the file, one a line, or with the tables that no stage reads.
    """
    if "rubber" in content:
        return validate(TyreCase, content, path, TAGS)
    kind = KINDS.get(str(_table(content, ("structure",)).get("kind")))
    case = validate(Case, content, path, TAGS | dict(kind.models if kind else {}))
    stages = stages_of(case.tables)
    read = {"title"}.union(*(case.tables if one.reads is None else one.reads for one in stages))
    defaults = {name: field.default for name, field in Case.model_fields.items()}
    given = [name for name, value in case if value not in (None, defaults[name])]
    if unread := [name for name in given if name not in read]:
        of_tables = {name for name, value in content.items() if isinstance(value, dict)}
        tables = " and ".join(f"[{name}]" if name in of_tables else name for name in unread)
        raise CaseError(
            f"{path}: {tables} would be read by no stage of this case, which has the stages "
            f"{', '.join(one.name for one in stages)}; leave it out"
        )
    return case

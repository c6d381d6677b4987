"""Case files: found by path or name, read, and refused in sentences."""

import tomllib
from collections.abc import Iterator
from difflib import get_close_matches
from importlib import resources
from pathlib import Path

from pydantic import BaseModel, ValidationError

from multiscale.errors import CaseError
from multiscale.io import read_text
from multiscale.pipeline.settings import Case, InstrumentSurface, SyntheticSurface

__all__ = ["find_case", "load_case", "shipped_cases"]


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
    try:
        content = tomllib.loads(read_text(path))
    except tomllib.TOMLDecodeError as error:
        raise CaseError(f"{path}: not valid TOML: {error}") from error
    for name in ("body_1", "body_2"):
        surface = (
            content.get(name, {}).get("surface") if isinstance(content.get(name), dict) else None
        )
        if isinstance(surface, dict) and isinstance(surface.get("file"), str):
            surface["file"] = str(path.parent.resolve() / surface["file"])
    try:
        return Case.model_validate(content)
    except ValidationError as error:
        raise CaseError("\n".join(f"{path}: {fault}" for fault in _faults(error))) from error


def _faults(error: ValidationError) -> Iterator[str]:
    """Turn pydantic's report into sentences, one for each fault."""
    for fault in sorted(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden"):
        place: list[str] = []
        for part in fault["loc"]:
            if isinstance(part, int):
                place[-1] += f"[{part}]"
            elif part not in ("synthetic", "instrument"):
                place.append(part)
        if fault["type"] == "value_error" and isinstance(fault["input"], dict):
            place.append("")  # a check of the whole table
        table, key = ".".join(place[:-1]), place[-1] if place else ""
        where = f"[{table}] " if table else ""
        if fault["type"] == "extra_forbidden":
            known = _known_keys(Case, [str(part) for part in fault["loc"][:-1]])
            close = get_close_matches(key, known, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"known keys: {', '.join(known)}"
            yield f"{where}has no key {key!r}; {hint}"
        elif fault["type"] == "missing":
            yield f"{where}{key} is missing"
        else:
            message = fault["msg"].removeprefix("Value error, ").removeprefix("Input ")
            message = message[:1].lower() + message[1:]
            if fault["type"] == "model_type":
                message = "should be a table"
            elif fault["type"] == "tuple_type":
                message = "should be a list"
            elif fault["type"] == "too_long" and isinstance(fault["input"], list):
                message = f"should have {fault['ctx']['max_length']} entries"
            elif fault["type"] == "path_type":
                message = "should be a path as text"
            told = fault["type"] == "value_error" or isinstance(fault["input"], dict)
            found = "" if told else f", got {fault['input']!r}"
            yield f"{where}{key + ' ' if key else ''}{message}{found}"


def _known_keys(model: type[BaseModel], place: list[str]) -> list[str]:
    """Keys of the table at a place in the case."""
    for name in place:
        if name == "synthetic":
            model = SyntheticSurface
        elif name == "instrument":
            model = InstrumentSurface
        elif name in model.model_fields and name != "surface":
            annotation = model.model_fields[name].annotation
            if isinstance(annotation, type) and issubclass(annotation, BaseModel):
                model = annotation
    return list(model.model_fields)

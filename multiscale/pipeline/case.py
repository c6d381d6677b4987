"""Case files: search by path or name, reading, and error messages."""

from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from multiscale.errors import CaseError, suggest
from multiscale.pipeline.stages import stages_of
from multiscale.pipeline.tables.rough_bodies import InstrumentSurface, SyntheticSurface
from multiscale.pipeline.tables.settings import KINDS, Case
from multiscale.pipeline.tables.toml_model import Settings, read_toml, validate
from multiscale.schema import INTERFACE_LAW, RVE, Schema

TAGS: dict[str, type[Settings]] = {
    "synthetic": SyntheticSurface,
    "instrument": InstrumentSurface,
    **KINDS,
}
"""Tables that come in several kinds."""

FILES = (
    ("body_1", "surface", "file"),
    ("body_2", "surface", "file"),
    *(("structure", key) for key in ("nodes", "links", "file", "stiffness", "rve")),
    *(("structure", "bodies", key) for key in ("mesh", "coarser", "stiffness", "rve")),
    ("structure", "interfaces", "law"),
    ("structure", "interfaces", "gap", "file"),
    ("interface", "law"),
    ("cell", "mesh"),
    ("rve", "image", "file"),
    *(("measured", key) for key in ("file", "case")),
)
"""Keys of tables, and of lists of tables, that name files."""

OF_RUNS = {"law": INTERFACE_LAW, "rve": RVE}
"""Keys of datasets that may also come from the folder of a run, or from a shipped case."""

MOVED = {
    "joint": 'height and width in [structure] kind = "blocks", preloads in [statics], the rest in '
    "[interface]",
    "loading": "preloads in [statics], the rest in [cycles]",
}
"""Tables of earlier versions, and the present places of their keys."""

GONE: dict[tuple[str, str], str] = {
    ("motion", "domains"): "grains are not cut into domains; delete the key",
    ("interface", "damage_file"): "state the damage of every interface by damage",
}
"""Removed keys of earlier versions, and the remedy."""


def shipped_cases() -> dict[str, Path]:
    """Return names and paths of the cases that come with the package."""
    inside = Path(str(resources.files("multiscale"))) / "microcases"
    checkout = Path(str(resources.files("multiscale"))).parent / "microcases"
    folder = inside if inside.is_dir() else checkout
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def find_case(case: str | Path) -> Path:
    """Return the path of a case file, or of the shipped case of that name."""
    shipped = shipped_cases()
    path = Path(case)
    if path.is_dir() and str(case) not in shipped:
        raise CaseError(f"{path} is a folder; give the case file in it")
    if path.suffix or path.is_file():
        return path
    if str(case) in shipped:
        return shipped[str(case)]
    hint = suggest(str(case), shipped, f"shipped cases: {', '.join(shipped)}")
    raise CaseError(f"no case named {str(case)!r}; {hint}")


def load_case(case: str | Path) -> Case:
    """Read a case file.

    Parameters
    ----------
    case : str or Path
        Path of a TOML file, or the name of a shipped case. Paths in the file are relative to its
        folder.

    Raises
    ------
    CaseError
        If there is no such case, or the file has faults; the message has a line for each.

    Examples
    --------
    >>> load_case("ground_steel").cell.points
    (128, 128)
    """
    path = find_case(case)
    content = read_case(path)
    if "sweep" in content:
        raise CaseError(f"{path}: contains [sweep]; load it with load_sweep")
    return validate_case(content, path)


def case_of_image(
    image: Path, youngs_modulus: str, poissons_ratio: float, voxel_size: str, void_value: float
) -> Case:
    """Return the case of a representative volume with a binary image in a file or a folder.

    Parameters
    ----------
    youngs_modulus, voxel_size : str
        Quantities as in case files; an empty size of the voxels is read from the image.

    Raises
    ------
    CaseError
        If a quantity is refused.
    """
    stack = {"file": str(image.resolve()), "void_value": void_value}
    solid = {"youngs_modulus": youngs_modulus, "poissons_ratio": poissons_ratio}
    table = solid | {"image": stack | ({"voxel_size": voxel_size} if voxel_size else {})}
    return validate(Case, {"title": f"Volume of {image.name}", "rve": table}, image, TAGS)


def read_case(path: Path) -> dict[str, Any]:
    """Read a case file without checking it; paths of other files become absolute."""
    content = read_toml(path)
    for table, places in MOVED.items():
        if table in content or table in _table(content, ("sweep",)):
            raise CaseError(f"{path}: the keys of [{table}] of earlier versions are now {places}")
    for (table, key), instead in GONE.items():
        if key in _table(content, (table,)):
            raise CaseError(f"{path}: [{table}] no longer has the key {key!r}: {instead}")
    for *tables, key in FILES:
        for named in _tables(content, tables):
            if isinstance(named.get(key), str):
                named[key] = str(_find_file(path.parent.resolve() / named[key], OF_RUNS.get(key)))
    return content


def _tables(content: dict[str, Any], names: Sequence[str]) -> list[dict[str, Any]]:
    tables = [content]
    for name in names:
        inner = [table.get(name) for table in tables]
        every = [
            entry for value in inner for entry in (value if isinstance(value, list) else [value])
        ]
        tables = [entry for entry in every if isinstance(entry, dict)]
    return tables


def _find_file(file: Path, schema: Schema | None) -> Path:
    """Return the file; or the dataset in the folder of a run, or a shipped case."""
    if schema is not None and file.is_dir():
        return file / f"{schema.name}.nc"
    if schema is not None and not file.exists():
        return shipped_cases().get(file.name, file)
    return file


def taken_law(file: Path, quick: bool) -> tuple[Path, Case]:
    """Return the part of a case that makes its law, and its place in another case's run folder."""
    other = load_case(file)
    if not other.makes_law:
        raise CaseError(f"{file}: the case has no cells, so it makes no law")
    return _placed("laws", file, other.without_structure(), quick)


def taken_volume(file: Path, quick: bool) -> tuple[Path, Case]:
    """Return the part of a case that makes its representative volume, and its place."""
    return _placed("volumes", file, load_case(file).only_rve(), quick)


def _placed(kind: str, file: Path, case: Case, quick: bool) -> tuple[Path, Case]:
    """Return a case, or its quick variant, and its place in the run folder of another case."""
    case = case.quick() if quick else case
    return Path(kind) / f"{file.stem}-{case.checksum()[:8]}", case


def taken_cases(case: Case) -> dict[Path, Case]:
    """Return the cases that make laws and volumes of a case, by places in its run folder."""
    if case.structure is None:
        return {}
    laws, volumes = case.structure.taken_laws(case), case.structure.taken_volumes()
    return dict(
        take(file, quick)
        for take, named in ((taken_law, laws), (taken_volume, volumes))
        for file, quick in sorted(named)
        if file.suffix == ".toml"
    )


def _table(content: dict[str, Any], names: Sequence[str]) -> dict[str, Any]:
    for name in names:
        inner = content.get(name)
        content = inner if isinstance(inner, dict) else {}
    return content


def validate_case(content: dict[str, Any], path: Path) -> Case:
    """Turn the content of a case file into settings."""
    kind = KINDS.get(str(_table(content, ("structure",)).get("kind")))
    case = validate(Case, content, path, TAGS | dict(kind.models if kind else {}))
    stages = stages_of(case.tables)
    read = {"title"}.union(
        *(case.tables if stage.reads is None else stage.reads for stage in stages)
    )
    defaults = {name: field.default for name, field in Case.model_fields.items()}
    given = [name for name, value in case if value not in (None, defaults[name])]
    if case.structure is not None and case.way == "direct":
        try:
            case = case.structure.with_wide_cells(case)
        except CaseError as error:
            raise CaseError(f"{path}: {error}") from None
    if unread := [name for name in given if name not in read]:
        of_tables = {name for name, value in content.items() if isinstance(value, dict)}
        tables = " and ".join(f"[{name}]" if name in of_tables else name for name in unread)
        raise CaseError(
            f"{path}: no stage of this case reads {tables}; its stages are "
            f"{', '.join(stage.name for stage in stages)}; leave {tables} out"
        )
    return case

"""Write the pages of keys of case files from the models that read them.

    python workflows/manual/keys.py

from the root of a checkout renews ``microcases/manual/keys_*.md`` and their list in
``microcases/README.md``.
"""

import ast
import json
import re
from collections.abc import Iterator
from functools import cache
from inspect import getdoc, getsource
from itertools import pairwise, product
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BeforeValidator, WrapValidator
from pydantic.fields import FieldInfo

from multiscale.pipeline.tables.settings import KINDS, Case
from multiscale.pipeline.tables.toml_model import OneOf, Settings
from multiscale.units import readable

CASES = Path(__file__).parents[2] / "microcases"
BEGIN, END = "<!-- keys: written by workflows/manual/keys.py -->\n", "\n<!-- end of keys -->"

PAGES = {
    "surfaces": ("bodies and their surfaces", "Case RoughBody"),
    "cells": (
        "cells and their law",
        "CellSettings MicroSettings LawSettings MeasuredTable SlideSettings SealSettings "
        "AccuracySettings",
    ),
    "joints": (
        "blocks and lap joints",
        "Blocks StackedBlocks LapJoint LawSource RoughInterface RisingPreloads JointPreloads "
        "Cycles",
    ),
    "bodies": (
        "bodies, their vibration and life",
        "Bodies JointLaw LoadSteps LoadCycles VibrationSettings FatigueSettings",
    ),
    "links": (
        "trusses, nets, plates and substructures",
        "TensegrityGrid EquivalentPlate CableNet LinkTable LinkMesh Plate LoadFactors Statics "
        "Dynamics Substructures",
    ),
    "volumes": ("volumes with pores and cracks", "RveSettings GrowthSettings"),
    "grains": (
        "grains",
        "Deposit Silo ColumnCollapse ShearCell Biaxial GrainSettings Motion ThirdBody",
    ),
    "tyres": (
        "tyres on a road",
        "Rubber SyntheticSurface Slides Tread",
    ),
}
"""Content and models of the tables of every page."""

LISTED = "[]"
"""Ends the names of lists of tables on the way to a key."""
HEAD = "| key | value | default | meaning |\n| --- | --- | --- | --- |"
BOUNDS = {"gt": "> {:g}", "ge": "≥ {:g}", "lt": "< {:g}", "le": "≤ {:g}", "multiple_of": "even"}
"""Signs of ranges; the only multiple asked for is of two."""


def main() -> None:
    """Renew the pages of keys and their list."""
    for name, text in key_pages().items():
        (CASES / "manual" / name).write_text(text, encoding="utf-8")
    index = CASES / "README.md"
    index.write_text(renew(index.read_text(encoding="utf-8")), encoding="utf-8")


def key_pages() -> dict[str, str]:
    """Return every page of keys with their units, ranges, defaults and meanings, by its name."""
    return {
        f"keys_{name}.md": f"# Keys of {title}\n\n"
        "[Case files](../README.md#keys) explains the columns.\n\n"
        + "\n\n".join(text for _, text in _sections(models))
        + "\n"
        for name, (title, models) in PAGES.items()
    }


def renew(index: str) -> str:
    """Write the list of tables and their pages between its marks."""
    rows = ["| keys of | tables |", "| --- | --- |"]
    for name, (title, models) in PAGES.items():
        page = f"manual/keys_{name}.md"
        links: dict[str, str] = {}
        for head, _ in _sections(models):
            if "." not in head:
                short = _short(head)
                links.setdefault(short, f"[{short}]({page}#{_anchor(head)})")
        rows.append(f"| [{title}]({page}) | {', '.join(links.values())} |")
    before, rest = index.split(BEGIN)
    return before + BEGIN + "\n".join(rows) + END + rest.split(END)[1]


def _short(heading: str) -> str:
    """Name a table by its kind, or without the kinds that it serves."""
    kind = re.search(r'"(\w+)"', heading)
    return f"`{kind[1]}`" if kind else heading.split(" of `")[0]


def _anchor(heading: str) -> str:
    """Return the anchor of a heading."""
    return re.sub(r"[^\w -]", "", heading).replace(" ", "-").lower()


def _sections(models: str) -> list[tuple[str, str]]:
    """Return heading and text of the tables of some models and of the tables in them."""
    results: list[tuple[str, str]] = []
    for top, head, names, table in _tables(Case, ()):
        if top.__name__ in models.split():
            meaning = _plain((getdoc(table) or "").split("\n\n")[0]) + _beside(table)
            rows = "\n".join([HEAD, *(_row(table, name) for name in names)]) if names else ""
            section = head, f"## {head}\n\n{meaning}\n\n{rows}".rstrip()
            if section not in results:  # laws of links stand in two kinds
                results.append(section)
    return results


def _beside(table: type[Settings]) -> str:
    """Name the tables that a kind of structure takes."""
    if table not in KINDS.values():
        return ""
    sets = [set(tables) for tables in table.asks]
    always = sorted(set.intersection(*sets))
    also = " or ".join(f"`[{name}]`" for name in sorted(set.union(*sets) - {*always}))
    parts = [" and ".join(f"`[{name}]`" for name in always), also]
    return f" It takes {', also '.join(filter(None, parts))}."


def _tables(
    model: type[Settings],
    at: tuple[tuple[str, ...], ...],
    top: type[Settings] | None = None,
) -> Iterator[tuple[type[Settings], str, list[str], type[Settings]]]:
    """Return the outermost table, head, keys and model of a table, then of the tables in it.

    ``at`` has the names on the way to the table, several where several tables are alike.
    """
    inner = {
        name: tuple(_models(field.rebuild_annotation()))
        for name, field in model.model_fields.items()
    }
    head = _head(model, at)
    selector = "kind" if "kind" in head else ""
    yield (
        top or model,
        head,
        [name for name in inner if not inner[name] and name != selector],
        model,
    )
    for models in dict.fromkeys(inner.values()):
        names = tuple(
            name + LISTED * _is_list(model.model_fields[name].rebuild_annotation())
            for name in inner
            if inner[name] == models
        )
        for inner_model in models:
            named = [("NAME",)] if {"laws", "volumes"} & {*names} else []
            yield from _tables(
                inner_model, (*at, names, *named), top or (inner_model if at == () else None)
            )


def _head(model: type[Settings], at: tuple[tuple[str, ...], ...]) -> str:
    """Name a table as files do, with its kind or the kinds that it serves."""
    kind = model.model_fields.get("kind")
    values = get_args(kind.annotation) if kind else ()
    if len(values) == 1:
        return f'`[structure]`, `kind = "{values[0]}"`'
    served = ", ".join(
        f"`{name}`" for name, kinds in KINDS.items() if model in kinds.models.values()
    )
    paths = ", ".join(_say_path(path) for path in product(*at) if path)
    return paths + f" of {served}" * bool(served) if at else "Head of the file"


def _say_path(path: tuple[str, ...]) -> str:
    """Write the place of a table, or of the tables of a list."""
    place = ".".join(path).replace(LISTED, "")
    return f"`[[{place}]]`" if path[-1].endswith(LISTED) else f"`[{place}]`"


def _is_list(hint: Any) -> bool:
    """Whether a file has a list of such tables."""
    return get_origin(_parts(hint)[0]) is tuple


def _row(model: type[Settings], name: str) -> str:
    """Describe a key in a line of a table."""
    field = model.model_fields[name]
    hint = field.rebuild_annotation()
    default = _default(field, _unit(hint))
    return f"| `{name}` | {_value(hint)} | {default} | {_meaning(model, name)} |"


def _meaning(model: type[Settings], name: str) -> str:
    """Return the meaning of a key: its description, or the docstring below it."""
    results = [_docstrings(item)[name] for item in model.__mro__ if name in _docstrings(item)]
    return model.model_fields[name].description or (results[0] if results else "")


@cache
def _docstrings(model: type) -> dict[str, str]:
    """Docstrings of the keys that a model itself declares."""
    if model is Settings or not issubclass(model, Settings):
        return {}
    body = ast.parse(getsource(model)).body[0].body  # type: ignore[attr-defined]
    return {
        key.target.id: " ".join(text.value.value.split())
        for key, text in pairwise(body)
        if isinstance(key, ast.AnnAssign)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
    }


def _plain(text: str) -> str:
    """Undo the marks of the docstrings."""
    return re.sub(r":\w+:`~?([^`]*)`", r"`\1`", " ".join(text.replace("``", "`").split()))


def _default(field: FieldInfo, unit: str) -> str:
    """Write a default as a file would."""
    value = field.default
    if field.is_required():
        return "required"
    if value in (None, (), {}, ""):
        return ""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, float) and unit != "1":
        simple = not set("/^") & set(unit)
        return f'`"{readable(f"{value!r} {unit}") if simple else f"{value:g} {unit}"}"`'
    if isinstance(value, str):
        return f'`"{value}"`'
    return f"`{list(value) if isinstance(value, tuple) else f'{value:g}'}`"


def _parts(hint: Any) -> tuple[Any, list[Any]]:
    """Type and metadata of an annotation, with nested annotations joined and None left out."""
    if get_origin(hint) is Annotated:
        inner, *metadata = get_args(hint)
        kind, more = _parts(inner)
        return kind, more + metadata
    if get_origin(hint) in (Union, UnionType):
        results = [member for member in get_args(hint) if member is not NoneType]
        if len(results) == 1:
            return _parts(results[0])
    return hint, []


def _models(hint: Any) -> list[type[Settings]]:
    """Tables that an annotation names."""
    kind, metadata = _parts(hint)
    chosen = [model for item in metadata if isinstance(item, OneOf) for model in item.models]
    if chosen:
        return chosen
    if isinstance(kind, type) and issubclass(kind, Settings):
        return [kind]
    if get_origin(kind) in (Union, UnionType, dict, tuple):
        return [model for member in get_args(kind) for model in _models(member)]
    return []


def _unit(hint: Any) -> str:
    """SI unit of a quantity."""
    kind, _ = _parts(hint)
    if "unit" in (read := _reading(hint)):
        return str(read["unit"])
    return next(filter(None, map(_unit, get_args(kind))), "") if get_origin(kind) is tuple else ""


def _reading(hint: Any) -> dict[str, Any]:
    """Return the options of what reads a quantity."""
    for item in _parts(hint)[1]:
        if isinstance(item, BeforeValidator | WrapValidator):
            return getattr(item.func, "keywords", {})
    return {}


def _value(hint: Any) -> str:
    """Describe the allowed values in a few words."""
    kind, metadata = _parts(hint)
    bounds = _bounds(metadata)
    if get_origin(kind) is Literal:
        return " or ".join(f"`{json.dumps(value)}`" for value in get_args(kind))  # as in TOML
    if get_origin(kind) in (Union, UnionType):
        return " or ".join(_value(member) for member in get_args(kind) if member is not NoneType)
    if get_origin(kind) is tuple:
        return _list(get_args(kind), bounds)
    if get_origin(kind) is dict:
        return f"table, each {_value(get_args(kind)[1])}"
    if unit := _unit(hint):
        spread = " ±" if _reading(hint).get("uncertain") else ""
        return ", ".join([("number" if unit == "1" else unit) + spread, *_range(bounds)])
    words = {int: "integer", bool: "`true` or `false`", str: "text", Path: "path"}
    return ", ".join([words[kind], *_range(bounds)])


def _list(items: tuple[Any, ...], bounds: dict[str, Any]) -> str:
    """Describe the number and kind of the values of a list."""
    if items[-1] is not Ellipsis:
        lines = [_value(item) for item in items]
        return f"{len(lines)} × {lines[0]}" if len(set(lines)) == 1 else f"[{'; '.join(lines)}]"
    low, high = bounds.get("min_length", 0), bounds.get("max_length")
    count = f"{low} × " if low == high else f"list of {low} or more: " if low else "list: "
    return count + _value(items[0])


def _bounds(metadata: list[Any]) -> dict[str, Any]:
    """Constraints of a field by their names."""
    results = [entry for item in metadata for entry in getattr(item, "metadata", [item])]
    names = (*BOUNDS, "min_length", "max_length")
    return {
        name: getattr(entry, name) for entry in results for name in names if hasattr(entry, name)
    }


def _range(bounds: dict[str, Any]) -> list[str]:
    """Write the range of a number."""
    limits = {name: text.format(bounds[name]) for name, text in BOUNDS.items() if name in bounds}
    if "gt" in limits:
        limits.pop("ge", None)
    if "ge" in limits and "le" in limits:
        limits = {"ge": f"{bounds['ge']:g} to {bounds['le']:g}"} | {
            name: text for name, text in limits.items() if name not in ("ge", "le")
        }
    return list(limits.values())


if __name__ == "__main__":
    main()

"""TOML files as frozen models with quantities in SI units and readable faults."""

import json
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PlainSerializer,
    SerializationInfo,
    Strict,
    ValidationError,
    WrapValidator,
    model_validator,
)

from multiscale.errors import CaseError, suggest
from multiscale.io import read_text
from multiscale.io.files import read_bytes
from multiscale.units import to_si


class Typed(float):
    """A float in an SI unit, with the text of the file from which it was read."""

    text: str
    unit: str
    half_width: float = 0.0  # of its 95 % interval, over the value


def quantity(unit: str, *, uncertain: bool = False) -> WrapValidator:
    """Read text such as ``"0.8 um"`` as a float in an SI unit."""
    return WrapValidator(partial(_convert, unit=unit, uncertain=uncertain))


def _convert(
    value: object, check: Callable[[float], float], *, unit: str, uncertain: bool
) -> float:
    stated, sign, spread = value, "", ""
    if uncertain and isinstance(value, str):
        stated, sign, spread = value.replace("±", "+-").partition("+-")
    try:
        number = check(to_si(stated, unit))
        half = to_si(spread, "1" if spread.rstrip().endswith("%") else unit) if sign else 0.0
    except CaseError as error:
        raise ValueError(str(error)) from error
    if not isinstance(value, str):
        return number
    typed = Typed(number)
    typed.text, typed.unit = value, unit
    if sign:
        typed.half_width = half if spread.rstrip().endswith("%") else half / (number or 1.0)
        if not 0.0 < typed.half_width < 1.0:
            raise ValueError("should have a positive half-width behind +-, smaller than the value")
    return typed


def with_unit(unit: str) -> PlainSerializer:
    """Write a float as in its file, or with its SI unit; Python objects only if uncertain."""

    def write(value: float, info: SerializationInfo) -> Any:
        if isinstance(value, Typed):
            return value.text if info.mode == "json" or value.half_width else value
        return f"{value!r} {unit}" if info.mode == "json" and unit != "1" else value

    return PlainSerializer(write, return_type=Any)


Length = Annotated[float, quantity("m"), Field(gt=0.0), with_unit("m")]
Pressure = Annotated[float, quantity("Pa"), Field(gt=0.0), with_unit("Pa")]
Duration = Annotated[float, quantity("s"), Field(gt=0.0), with_unit("s")]
Density = Annotated[float, quantity("kg/m^3"), Field(gt=0.0), with_unit("kg/m^3")]
UncertainPressure = Annotated[float, quantity("Pa", uncertain=True), Field(gt=0.0), with_unit("Pa")]
UncertainLength = Annotated[float, quantity("m", uncertain=True), Field(gt=0.0), with_unit("m")]
UncertainNumber = Annotated[float, quantity("1", uncertain=True), with_unit("1")]
UncertainFactor = Annotated[UncertainNumber, Field(ge=0.0)]
Number = Annotated[float, quantity("1")]
Share = Annotated[Number, Field(ge=0.0, le=1.0)]
Tolerance = Annotated[Number, Field(gt=0.0, lt=1.0)]
Factor = Annotated[Number, Field(ge=0.0)]
Ratio = Annotated[Number, Field(ge=0.0, le=0.4999)]  # of Poisson
Count = Annotated[int, Strict()]
Positive = Annotated[Count, Field(ge=1)]
Natural = Annotated[Count, Field(ge=0)]


@dataclass(frozen=True)
class Quick:
    """Change of a key in quick cases, from table and value, as metadata of the field."""

    of: Callable[[Any, Any], Any]


def at_most(limit: int) -> Quick:
    """Return the limit of a number in quick cases, if it is given."""
    return Quick(lambda _, value: value and min(limit, value))


def list_tables(names: Iterable[str]) -> str:
    """Format names of tables as in files."""
    return " and ".join(f"[{name}]" for name in names) or "none of them"


def _must_rise(values: tuple[float, ...]) -> tuple[float, ...]:
    for early, late in pairwise(values):
        if late <= early:
            raise ValueError(f"must rise from one to the next, but {late:g} follows {early:g} (SI)")
    return values


Real = TypeVar("Real", bound=float)
RISE = AfterValidator(_must_rise)
Rising = Annotated[tuple[Real, ...], RISE]
"""A list of values that rise."""


class Settings(BaseModel):
    """A table of a file: frozen, and without unknown keys.

    The meaning of a key is its description or, where it is longer than a line, the docstring below.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    @property
    def tables(self) -> frozenset[str]:
        """Tables and keys that are given or have a default."""
        return frozenset(name for name, value in self if value is not None)

    def _faults(self) -> Iterator[str]:
        """Yield sentences on inconsistent values; the first refuses the table."""
        yield from ()

    @model_validator(mode="after")
    def _refuse(self) -> Self:
        for fault in self._faults():
            raise ValueError(fault)
        return self

    def checksum(
        self,
        *,
        include: set[str] | dict[str, Any] | None = None,
        exclude: set[str] | dict[str, Any] | None = None,
    ) -> str:
        """Return the checksum of all values, with the content of named files."""
        values = self.model_dump(include=include, exclude=exclude)
        text = json.dumps(values, default=_content)
        return sha256(text.encode()).hexdigest()

    def uncertain(self, factor: float) -> Iterator[tuple[str, float, Self]]:
        """Yield key and half-width of every uncertain value, and settings with a new value."""
        for name, value in self:
            if isinstance(value, Typed) and value.half_width:
                yield name, value.half_width, self.model_copy(update={name: factor * value})
            listed = isinstance(value, tuple)
            for k, entry in enumerate(value if listed else (value,)):
                for key, half, changed in (
                    entry.uncertain(factor) if isinstance(entry, Settings) else ()
                ):
                    at = f"{name}[{k}]" if listed else name
                    new = (*value[:k], changed, *value[k + 1 :]) if listed else changed
                    yield f"{at}.{key}", half, self.model_copy(update={name: new})

    def smaller(self) -> Self:
        """Return the table of a quick case, changed by :class:`Quick` here and in inner tables."""
        changes = {}
        for name, key in type(self).model_fields.items():
            value = getattr(self, name)
            for quick in key.metadata:
                value = quick.of(self, value) if isinstance(quick, Quick) else value
            changes[name] = _smaller(value)
        return self.model_copy(update=changes)

    def to_toml(self) -> str:
        """Return these settings as TOML, with quantities as given."""
        import tomli_w

        return tomli_w.dumps(self.model_dump(mode="json", exclude_none=True))


def _smaller(value: Any) -> Any:
    """Return the value of a quick case, for a table or each entry of a list."""
    if isinstance(value, Settings):
        return value.smaller()
    return tuple(map(_smaller, value)) if isinstance(value, tuple) else value


class TimeSteps(Settings):
    """A motion in time steps."""

    step: Duration = Field(description="Time step, s; shortened to divide the duration.")
    duration: Duration = Field(description="Duration of the motion, s.")

    def _faults(self) -> Iterator[str]:
        if self.step > self.duration:
            yield f"step ({self.step:g} s) must not be longer than duration ({self.duration:g} s)"


@dataclass(frozen=True)
class OneOf:
    """Possible models of a table, as metadata; another table of the file chooses the model."""

    models: tuple[type[Settings], ...]


AnySettings = TypeVar("AnySettings", bound=Settings)
Kinds = Mapping[str, type[BaseModel]]


def _content(file: Path) -> str:
    """Checksum of a file, and of the files named in it if it is a case."""
    checksum = sha256(read_bytes(file)).hexdigest()
    if file.suffix != ".toml":
        return checksum
    named = [file.parent / text for text in _texts(read_toml(file))]
    return " ".join(
        [checksum, *(_content(other) for other in named if other != file and other.is_file())]
    )


def _texts(value: Any) -> Iterator[str]:
    """Yield all texts that may name a file."""
    if isinstance(value, str):
        yield from (value,) if value.strip() and "\n" not in value else ()
    elif isinstance(value, dict | list):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _texts(inner)


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file."""
    text = read_text(path)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place = re.search(r"\(at line (\d+),", str(error))
        line = f": {text.splitlines()[int(place[1]) - 1].strip()}" if place else ""
        message = str(error).replace("Cannot overwrite a value", "the key is given twice")
        raise CaseError(f"{path}: not valid TOML: {message}{line}") from error


def validate(
    model: type[AnySettings], content: dict[str, Any], path: Path, kinds: Kinds
) -> AnySettings:
    """Return the content of a file as settings, with the models of ``kinds`` by their tags."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        lines = read_text(path).splitlines() if path.is_file() else []
        faults = _faults(error, model, kinds, _key_lines(lines))
        raise CaseError("\n".join(f"{path}: {fault}" for fault in faults)) from error


HEADER, ENTRY = re.compile(r"\s*\[(\[?)\s*([\w.\- ]+?)\s*\]"), re.compile(r"\s*([\w.-]+)\s*=")
"""Lines of a TOML file that begin a table, or an entry of a list of tables, and a key."""


def _key_lines(lines: Sequence[str]) -> dict[str, str]:
    """Return the line of every table and key, by its full name, with a caret below its name."""
    marked, table, entries = dict[str, str](), "", dict[str, int]()
    for number, line in enumerate(lines, 1):
        if match := HEADER.match(line):
            table = name = match[2]
            if match[1]:
                entries[name] = entries.get(name, -1) + 1
                table = f"{name}[{entries[name]}]"
        elif match := ENTRY.match(line):
            name = f"{table}.{match[1]}" if table else match[1]
        else:
            continue
        begin, end = match.span(match.lastindex or 0)
        prefix = f"  line {number}: "
        caret = f"{' ' * (len(prefix) + begin)}{'^' * (end - begin)}"
        marked.setdefault(name, f"\n{prefix}{line}\n{caret}")
    return marked


def _faults(
    error: ValidationError, model: type[BaseModel], kinds: Kinds, marked: Mapping[str, str]
) -> Iterator[str]:
    """Turn pydantic's report into sentences, one per fault, each with its line."""
    for fault in sorted(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden"):
        if fault["type"] == "too_short" and len(fault["input"]) >= fault["ctx"]["min_length"]:
            continue  # an entry is faulty, which is reported
        place, found_in = _locate(fault["loc"], model, kinds)
        if fault["type"] == "value_error" and isinstance(fault["input"], dict):
            place.append("")  # a check of the whole table
        table, key = ".".join(place[:-1]), place[-1] if place else ""
        where = f"[{table}] " if table else ""
        full = re.sub(r"\[\d+\]$", "", ".".join(place))
        mark = marked.get(f"sweep.{full}", marked.get(full, ""))
        if fault["type"] == "extra_forbidden":
            keys = list(found_in.model_fields)
            hint = suggest(key, keys, f"known keys: {', '.join(keys)}")
            yield f"{where}has no key {key!r}; {hint}{mark}"
        elif fault["type"] == "missing":
            yield f"{where}{key} is missing"
        else:
            repeated = fault["type"] in REPEATING or isinstance(fault["input"], dict)
            given = "" if repeated else f", got {fault['input']!r}"
            yield f"{where}{key + ' ' if key else ''}{_message(fault)}{given}{mark}"


def _locate(
    loc: tuple[int | str, ...], model: type[BaseModel], kinds: Kinds
) -> tuple[list[str], type[BaseModel]]:
    """Keys on the way to a fault, without the tags of kinds, and the model of the last table."""
    place: list[str] = []
    for part in loc:
        if isinstance(part, int):
            place[-1] += f"[{part}]"
        elif part in model.model_fields:
            place.append(part)
            model = _model_in(model.model_fields[part].annotation) or kinds.get(part) or model
        elif part in kinds:
            model = kinds[part]
        elif "[" not in part:  # else a type in a union
            place.append(part)
    return place, model


def _model_in(annotation: Any) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    models = (_model_in(argument) for argument in get_args(annotation))
    return next((model for model in models if model is not None), None)


REPEATING = ("value_error", "union_tag_not_found", "union_tag_invalid")
"""Faults with a message that repeats the input."""

MESSAGES: dict[str, Callable[[Any], str]] = {
    "model_type": lambda fault: "should be a table",
    "model_attributes_type": lambda fault: "should be a table",
    "tuple_type": lambda fault: "should be a list",
    "path_type": lambda fault: "should be a path as text",
    "union_tag_not_found": lambda fault: "has no 'kind'",
    "union_tag_invalid": lambda fault: (
        f"has no kind {fault['ctx']['tag']!r}; known kinds: "
        f"{fault['ctx']['expected_tags'].replace(chr(39), '')}"
    ),
}
"""Sentences that replace the messages of pydantic."""


def _message(fault: Any) -> str:
    if fault["type"] in MESSAGES:
        return MESSAGES[fault["type"]](fault)
    if fault["type"] == "too_long" and isinstance(fault["input"], list):
        return f"should have {fault['ctx']['max_length']} entries"
    if fault["type"] == "too_short" and isinstance(fault["input"], list):
        return f"should have at least {fault['ctx']['min_length']} entries"
    message = str(fault["msg"]).removeprefix("Value error, ").removeprefix("Input ")
    return message[:1].lower() + message[1:]

"""Calls that are refused: rows of ``test_refused_calls.toml``, calls and their sentences."""

import builtins
import re
import tomllib
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from multiscale import errors

TABLES = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
ROWS = [
    pytest.param(table, call, id=f"{name}: {call}")
    for name, table in TABLES.items()
    for call in table["refused"]
]


@cache
def names_of(*modules):
    """All names of some modules; of two alike, the one of the first."""
    results = [import_module(module) for module in reversed(modules)]
    return {name: getattr(module, name) for module in results for name in dir(module)}


@pytest.mark.parametrize(("table", "call"), ROWS)
def test_a_call_is_refused_in_a_sentence(tmp_path, table, call):
    def file(content, name="table.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    kind, _, sentence = re.match(r"(\w*Error)?(: )?(.*)", table["refused"][call]).groups()
    kind = kind or table.get("error", "CaseError")
    text = table.get("call", "{}").replace("{}", call)
    with pytest.raises(
        getattr(errors, kind, None) or getattr(builtins, kind), match=sentence
    ) as refused:
        eval(text, {**names_of(*table["names"]), "np": np, "file": file})
    sentence = str(refused.value)
    assert "\n" not in sentence or refused.type is errors.SchemaError  # which lists all faults
    for path in tmp_path.iterdir():
        assert sentence.startswith(str(path))

"""One word, one thing: no two files of the package have one name, and no two modules share one."""

import ast
from collections import Counter
from pathlib import Path

import multiscale

PACKAGE = Path(multiscale.__file__).parent


def test_a_file_name_stands_once_in_the_package():
    count = Counter(file.name for file in PACKAGE.rglob("*.py") if file.name != "__init__.py")
    assert count
    assert [name for name, times in count.items() if times > 1] == []


def test_a_public_name_stands_in_one_module_of_the_package():
    count = Counter(
        name
        for file in PACKAGE.rglob("*.py")
        if file.name != "__init__.py"
        for node in ast.parse(file.read_text(encoding="utf-8")).body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
        for name in ast.literal_eval(node.value)
    )
    assert count
    assert [name for name, times in count.items() if times > 1] == []

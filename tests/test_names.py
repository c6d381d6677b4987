"""No two files of the package have the same name, and no name stands in two modules."""

import ast
from collections import Counter, defaultdict
from pathlib import Path

import multiscale

PACKAGE = Path(multiscale.__file__).parent


def test_a_file_name_stands_once_in_the_package():
    count = Counter(file.name for file in PACKAGE.rglob("*.py") if file.name != "__init__.py")
    assert count
    assert [name for name, times in count.items() if times > 1] == []


def test_a_name_that_modules_share_stands_in_one_module():
    homes = defaultdict(set)
    for file in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("multiscale."):
                module = PACKAGE.joinpath(*node.module.split(".")[1:]).with_suffix(".py")
                if module.is_file():  # packages pass the names of their modules on
                    for name in node.names:
                        homes[name.name].add(node.module)
    assert homes
    assert {name: modules for name, modules in homes.items() if len(modules) > 1} == {}

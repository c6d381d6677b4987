"""One word, one thing: no two files of the package have one name."""

from collections import Counter
from pathlib import Path

import multiscale

PACKAGE = Path(multiscale.__file__).parent


def test_a_file_name_stands_once_in_the_package():
    count = Counter(file.name for file in PACKAGE.rglob("*.py") if file.name != "__init__.py")
    assert count
    assert [name for name, times in count.items() if times > 1] == []

"""What several test folders share."""

from pathlib import Path

import pytest


def pytest_addoption(parser):
    parser.addoption(
        "--reference-data",
        metavar="PATH",
        type=Path,
        # the form with "=" keeps pytest from taking the folder for one of tests
        help="folder with measured and published data, not shipped: --reference-data=PATH",
    )


@pytest.fixture(scope="session")
def reference_data(request):
    path = request.config.getoption("--reference-data")
    if path is None:
        pytest.skip("needs measured data: give their folder with --reference-data=PATH")
    if not path.is_dir():
        pytest.fail(f"--reference-data {path} is not a folder")
    return path.resolve()

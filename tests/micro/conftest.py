"""What needs a library of the system."""

import pytest


@pytest.fixture(scope="session")
def gmsh():
    try:
        import gmsh
    except OSError as error:
        pytest.skip(
            f"gmsh lacks a system library ({error}); workflows/site/start.md names the packages"
        )
    return gmsh

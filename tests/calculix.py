"""CalculiX beside the package: a mark for tests that need it, and a run."""

import os
import subprocess
from shutil import which

import pytest

needs_calculix = pytest.mark.skipif(which("ccx") is None, reason="CalculiX (ccx) is not installed")


def run_calculix(folder, lines):
    """Run an input deck on one thread, and return the text of its tables."""
    (folder / "deck.inp").write_text("\n".join([*lines, ""]), encoding="ascii")
    threads = os.environ | {"OMP_NUM_THREADS": "1"}
    call = ["ccx", "-i", "deck"]
    subprocess.run(call, cwd=folder, capture_output=True, check=True, env=threads, timeout=900)
    return (folder / "deck.dat").read_text()

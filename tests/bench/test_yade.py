"""The same deposit by another code, where it is installed."""

from shutil import which

import numpy as np
import pytest

from multiscale.bench import yade
from multiscale.errors import ConvergenceError
from multiscale.macro.granulate import ContactLaw, deposit, simulate_grains

pytestmark = pytest.mark.skipif(which(yade.PROGRAM) is None, reason="YADE is not installed")


def heap(n):
    return deposit(np.full(n, 0.01), (0.1, 0.1), ContactLaw(compliance=0.02))


def test_yade_and_this_package_let_a_heap_settle_alike():
    model = heap(60)
    theirs, ours = yade.settle(model, 0.5), simulate_grains(model, 0.5, 2e-3)
    z = ours["position"].values[-1, :, 2]
    assert 2.0 * z.mean() == pytest.approx(theirs.height, rel=0.05)
    assert int(ours["n_contacts"][-1]) == pytest.approx(theirs.contacts, rel=0.1)
    assert theirs.overlap < 0.01
    assert theirs.steps == np.ceil(0.5 / yade.time_step(model))


def test_a_run_of_yade_that_fails_says_so(monkeypatch):
    monkeypatch.setattr(yade, "SCRIPT", "raise ValueError('no grains')")
    with pytest.raises(ConvergenceError, match=r"YADE left no deposit.*no grains"):
        yade.settle(heap(1), 0.1)

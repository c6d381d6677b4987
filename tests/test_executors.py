"""Reports of a worker that fails."""

from importlib import import_module

import pytest

from multiscale.errors import MultiscaleError
from multiscale.executors import process_pool, run_jobs


class OfMissingModule:
    """Argument that no worker can load."""

    def __reduce__(self):
        return import_module, ("no_such_module",)


class TwoCauses(Exception):
    """Exception that only its worker can create."""

    def __init__(self, first, second):
        super().__init__(first)


def fail():
    raise TwoCauses("no balance", "no load")


@pytest.mark.parametrize(
    ("function", "argument", "sentence"),
    [
        pytest.param(
            len,
            OfMissingModule(),
            "cannot load the function or data of its job: ModuleNotFoundError: "
            "No module named 'no_such_module'",
            id="import",
        ),
        pytest.param(
            fail, None, r"after 0 finished jobs \(TypeError: TwoCauses.__init__\(\)", id="result"
        ),
    ],
)
def test_a_worker_that_fails_of_an_exception_names_it(function, argument, sentence, capfd):
    arguments = () if argument is None else (argument,)
    with process_pool(1) as executor, pytest.raises(MultiscaleError, match=sentence):
        run_jobs(function, [(0, arguments)], executor, lambda key, result: None)
    assert "Traceback" not in capfd.readouterr().err

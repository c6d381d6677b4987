"""What the tests of cases share."""

import pytest


@pytest.fixture
def command(monkeypatch, capsys, tmp_path):
    """Call the command line in this process, in a folder of its own.

    Gives exit status, output and errors.
    """
    from multiscale.cli import main

    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        monkeypatch.setattr("sys.argv", ["multiscale", *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            main()
        said = capsys.readouterr()
        return end.value.code or 0, said.out, said.err

    return call

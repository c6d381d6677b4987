"""What the command line tells while it works."""

from multiscale import cli


def test_progress_tells_the_time_left_from_what_was_done_since_the_start(monkeypatch, capsys):
    clock = [0.0]
    monkeypatch.setattr(cli, "perf_counter", lambda: clock[0])
    with cli._progress(6, "points") as tell:  # two were kept from another run
        for clock[0], finished in ((100.0, 2), (110.0, 3), (130.0, 5), (140.0, 6)):
            tell(finished)
    assert capsys.readouterr().err.splitlines() == [
        "2 of 6 points",
        "3 of 6 points, about 30 s left",
        "5 of 6 points, about 10 s left",
        "6 of 6 points",
    ]


def test_long_times_are_told_in_minutes_and_hours():
    assert [cli._duration(t) for t in (89.0, 600.0, 9000.0)] == ["89 s", "10 min", "2.5 h"]

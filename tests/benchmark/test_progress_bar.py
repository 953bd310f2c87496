"""Progress in a log: few plain lines, none when quiet, a bar on a terminal alone."""

import sys

import pytest

from tracked_env.benchmark import progress_bar as bar


def test_in_a_log_progress_is_a_plain_line_at_most_every_thirty_seconds(
    capsys: pytest.CaptureFixture[str],
) -> None:
    now = 0.0
    report = bar.progress_lines(1000, clock=lambda: now)
    for _ in range(1000):  # a call every 0.1 s, 100 s in all
        now += 0.1
        report(1, "payload: oracle")
    shown = capsys.readouterr()
    assert shown.out == "" and "\r" not in shown.err
    assert shown.err.splitlines() == [
        " 30% payload: oracle: 0:30 elapsed, about 1:10 left",
        " 60% payload: oracle: 1:00 elapsed, about 0:40 left",
        " 90% payload: oracle: 1:30 elapsed, about 0:10 left",
    ]


def test_without_a_terminal_no_carriage_return_is_written(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bar, "LINE_PERIOD", 0.0)
    with bar.progress_bar(10) as report:
        for _ in range(10):
            report(1, "drift: adaptive")
    lines = capsys.readouterr().err
    assert lines.count("\n") == 10 and "\r" not in lines


def test_quiet_shows_no_progress_on_a_terminal_and_in_a_log(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bar, "LINE_PERIOD", 0.0)
    for terminal in (True, False):
        monkeypatch.setattr(sys.stderr, "isatty", lambda shown=terminal: shown)
        with bar.progress_bar(10, quiet=True) as report:
            report(10, "drift: adaptive")
    assert capsys.readouterr().err == ""

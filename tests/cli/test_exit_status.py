"""How a command ends: one line and an exit status for what the user can mend."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from tracked_env.benchmark.policy_interface import PolicyError
from tracked_env.cli.command_line import one_line, reported


@pytest.mark.parametrize(
    ("error", "status"),
    [(ValueError("wrong"), 2), *((of("wrong"), 1) for of in (PolicyError, OSError, ImportError))],
    ids=lambda value: type(value).__name__,
)
def test_errors_of_a_command_are_one_line_and_an_exit_status(
    error: Exception, status: int, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(arguments: Sequence[str], program: str) -> int:
        raise error

    assert reported(fails)([], "program") == status
    assert capsys.readouterr().err == "program: wrong\n"


def test_an_error_of_a_file_has_its_name_and_the_likely_cause(tmp_path: Path) -> None:
    with pytest.raises(OSError) as missing:
        (tmp_path / "log.csv").read_text()
    said = one_line(missing.value)
    assert said.startswith(f"{tmp_path / 'log.csv'}: no such file or directory. Is the name right")
    (tmp_path / "taken").write_text("")
    with pytest.raises(OSError) as taken:
        (tmp_path / "taken").mkdir()
    assert "A file stands where a folder is needed" in one_line(taken.value)
    assert one_line(OSError("wrong")) == "wrong"


@pytest.mark.parametrize("error", [BrokenPipeError(), TypeError("a fault of ours")])
def test_a_closed_pipe_and_faults_of_the_program_are_not_reported_as_errors_of_the_user(
    error: Exception,
) -> None:
    def fails(arguments: Sequence[str], program: str) -> int:
        raise error

    with pytest.raises(type(error)):
        reported(fails)([], "program")

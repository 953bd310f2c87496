"""A teacher that the tests of agents share, one for each process of the tests."""

import pytest

from tests.agents.agent_cases import archive_of, one_line, small
from train import main


@pytest.fixture(scope="session")
def teacher(tmp_path_factory):
    """The archive of a teacher with all sensors of the usual set."""
    folder = tmp_path_factory.mktemp("teacher")
    return archive_of(small(folder, augmentation="teacher"))


@pytest.fixture
def refused(capsys):
    """Train what is refused; the line that says why."""

    def line(config):
        capsys.readouterr()
        assert main(config) == 2
        return one_line(capsys)

    return line

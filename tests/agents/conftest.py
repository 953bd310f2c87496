"""A teacher that the tests of agents share, one for each process of the tests."""

import pytest

from tests.agents.agent_cases import small
from train import main


@pytest.fixture(scope="session")
def teacher(tmp_path_factory):
    """The archive of a teacher with all sensors of the usual set."""
    folder = tmp_path_factory.mktemp("teacher")
    assert main(small(folder, augmentation="teacher")) == 0
    return folder / "agent.zip"

"""What the tests of agents share as a fixture."""

import pytest

from tests.agents.agent_cases import one_line
from train import main


@pytest.fixture
def refused(capsys):
    """Train what is refused; the line that says why."""

    def line(config):
        capsys.readouterr()
        assert main(config) == 2
        return one_line(capsys)

    return line

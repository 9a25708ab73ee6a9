"""What is told of a stored run whose code or data have changed since."""

from pathlib import Path

import pytest

from campaign.paper.gather import FinishedRun
from campaign.store import RunFolder
from scenarios.errors import BoresightError


def test_a_run_of_another_version_names_the_command_that_makes_it_again(tmp_path: Path) -> None:
    run = FinishedRun(RunFolder(tmp_path), {"name": "rowell2015-database"})
    with pytest.raises(BoresightError, match=r"another version.*`boresight run rowell2015-database` again"):
        run.campaign()

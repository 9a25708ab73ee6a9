"""What a worker takes of a machine."""

import subprocess
import sys

import pytest

from boresight.campaign.machine import cores, sharing_cores

SCRIPT = """
import sys
import cv2, drjit, scipy.linalg
from threadpoolctl import threadpool_info
import boresight.campaign.runs.worker
from boresight.campaign.threads import use_threads
use_threads(int(sys.argv[1]))
blas = {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}
print(drjit.thread_count(), cv2.getNumThreads(), *blas)
"""


@pytest.mark.parametrize("jobs", [1, 2, 1000])
def test_a_worker_takes_its_share_of_threads(jobs):
    share = max(1, cores() // jobs)
    done = subprocess.run([sys.executable, "-c", SCRIPT, str(jobs)], capture_output=True, text=True, check=True)
    assert [int(word) for word in done.stdout.split()] == [share, share, 1]


def test_what_works_side_by_side_shares_the_cores():
    every = cores()
    with sharing_cores(2):
        assert cores() == max(1, every // 2)
        with sharing_cores(10 * every):
            assert cores() == 1
    assert cores() == every


AGAIN = """
import sys
from pathlib import Path
from threadpoolctl import threadpool_info
from boresight.campaign.inspection.case import Case
from boresight.campaign.inspection.recompute import recompute, reopened
from boresight.campaign.store import RunFolder
folder = RunFolder(Path(sys.argv[1]))
found = recompute(reopened(folder), folder, Case("scene", "landmark-harris", 1))
print(*{pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"})
"""


def test_a_case_is_recomputed_with_the_threads_of_its_run(tiny_run):
    """With two, matrices of a whole arc differ in their last bits, and a sound case would not be what is stored."""
    done = subprocess.run([sys.executable, "-c", AGAIN, tiny_run.folder], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1"]

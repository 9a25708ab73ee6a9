"""What a worker takes of a machine."""

import subprocess
import sys

import pytest

from campaign.machine import cores

SCRIPT = """
import sys
import cv2, drjit, scipy.linalg
from threadpoolctl import threadpool_info
import campaign.worker
from campaign.machine import use_threads
use_threads(int(sys.argv[1]))
blas = {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}
print(drjit.thread_count(), cv2.getNumThreads(), *blas)
"""


@pytest.mark.parametrize("jobs", [1, 2, 1000])
def test_a_worker_takes_its_share_of_threads(jobs):
    share = max(1, cores() // jobs)
    done = subprocess.run([sys.executable, "-c", SCRIPT, str(jobs)], capture_output=True, text=True, check=True)
    assert [int(word) for word in done.stdout.split()] == [share, share, 1]

"""What a worker takes of a machine."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from rounding import round_rays_otherwise
from threadpoolctl import threadpool_info, threadpool_limits
from tiny_campaign import TRIALS, run
from variants import variant_or_skip

from boresight.campaign import threads
from boresight.campaign.inspection.recompute import Case, recompute, reopened
from boresight.campaign.machine import cores, sharing_cores
from boresight.campaign.pool import workers as parallel
from boresight.campaign.runs.execute import trials_of
from boresight.campaign.store import RunFolder
from boresight.campaign.threads import workers
from boresight.renderers.mitsuba3 import variant
from boresight.renderers.mitsuba3.variant import CUDA, LLVM

SCRIPT = """
import sys
import cv2, drjit, scipy.linalg
from threadpoolctl import threadpool_info
import boresight.campaign.runs.execute
from boresight.campaign.threads import use_threads
for jobs in sys.argv[1:]:
    use_threads(int(jobs))
    blas = {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}
    print(drjit.thread_count(), cv2.getNumThreads(), *blas)
"""


def test_a_worker_takes_its_share_of_threads():
    jobs = (1000, 1, 2)
    words = [sys.executable, "-c", SCRIPT, *map(str, jobs)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    shares = [max(1, cores() // one) for one in jobs]
    assert [[int(word) for word in line.split()] for line in done.stdout.splitlines()] == [
        [share, share, 1] for share in shares
    ]


def test_what_works_side_by_side_shares_the_cores():
    every = cores()
    with sharing_cores(2):
        assert cores() == max(1, every // 2)
        with sharing_cores(10 * every):
            assert cores() == 1
    assert cores() == every


def blas_threads() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_a_case_is_recomputed_with_the_threads_of_its_run(tiny_run):
    """With two, matrices of a whole arc differ in their last bits, and a sound case would not be what is stored."""
    folder = RunFolder(tiny_run.folder)
    trials_of.cache_clear()  # as in a process that only inspects
    with threadpool_limits(limits=2, user_api="blas"):
        assert blas_threads() == {2}
        recompute(reopened(folder), folder, Case("scene", "landmark-harris", 1))
        assert blas_threads() == {1}


# --- Each worker renders on a GPU of its own, told by the driver's own variable --------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(("chosen", "expected"), [("0,3", {"0", "3"}), ("2", {"2"})])
def test_workers_share_the_gpus_out(monkeypatch, chosen, expected):
    rested = parallel._IdleWorkers()
    monkeypatch.setattr(parallel, "_idle_workers", lambda: rested)
    monkeypatch.setenv(variant.VISIBLE_GPUS, chosen)
    told = f"sleep 0.05; echo $PPID ${variant.VISIBLE_GPUS}"
    found, again = (set(parallel.in_order(2, subprocess.getoutput, [(told,)] * 8)) for _ in range(2))
    for worker in rested.taken(2):
        worker.close(kill=True)
    assert len(found) == 2, "two processes, each with one answer throughout"
    assert {one.split()[1] for one in found} == expected
    assert again == found, "they rest, and go on with the GPU that they have"


def test_there_are_as_many_workers_as_gpus_or_cores(monkeypatch):
    monkeypatch.setenv(variant.VISIBLE_GPUS, "0, 1,2")
    assert workers(None, CUDA) == 3
    assert workers(None, LLVM) == cores()
    assert workers(7, CUDA) == 7
    monkeypatch.delenv(variant.VISIBLE_GPUS)
    monkeypatch.setattr(variant, "nvidia_gpus", lambda: (2, ""))
    assert variant.gpu_names() == ("0", "1")
    assert [variant.gpu_of_worker(place)[variant.VISIBLE_GPUS] for place in range(3)] == ["0", "1", "0"]
    monkeypatch.setattr(variant, "nvidia_gpus", lambda: (0, "the NVIDIA driver finds no GPU"))
    assert variant.gpu_of_worker(0) == {}
    assert threads.workers(None, CUDA) == 1


# --- Rows where rays are rounded otherwise: they move, and by little ------------------------------------------------


def rows_of(file, folder, variant, trials=TRIALS) -> pd.DataFrame:
    assert run(file, folder, "--variant", variant, "--trials", trials) == 0
    return read_rows(folder)


def read_rows(folder) -> pd.DataFrame:
    rows = RunFolder(folder).table("rows")
    return rows[rows["estimator"] != "prior"].set_index("trial")


def assert_within_the_tolerance(rows: pd.DataFrame, others: pd.DataFrame, share: float = 0.75) -> None:
    """The same trials solved, that share of positions within 5 % of the median error, and that within 10 %.

    Nine positions of ten are the rule: of 24 trials three quarters may be asked for, as chance leaves fewer once in 70.
    """
    error, other = rows["position_error_m"], others["position_error_m"]
    assert (rows["status"] == others["status"]).all()
    assert not np.array_equal(error, other), "another variant"
    assert np.quantile(np.abs(error - other), share) < 0.05 * error.median()
    assert other.median() == pytest.approx(error.median(), rel=0.1)


@pytest.fixture(scope="module")
def llvm_rows(tiny_run, tmp_path_factory) -> pd.DataFrame:
    name = variant_or_skip(LLVM).name
    made = RunFolder(tiny_run.folder).read_manifest()["machine"]["variant"] == name
    return read_rows(tiny_run.folder) if made else rows_of(tiny_run.file, tmp_path_factory.mktemp("llvm"), name)


@pytest.mark.parametrize("sign", [1.0, pytest.param(-1.0, marks=pytest.mark.long)])
def test_rounding_of_rays_moves_rows_within_the_tolerance(tiny_run, llvm_rows, tmp_path, monkeypatch, sign):
    round_rays_otherwise(monkeypatch, sign)
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))  # images and landmarks of its own
    assert_within_the_tolerance(llvm_rows, rows_of(tiny_run.file, tmp_path / "other", LLVM))


@pytest.mark.long
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_of_many_trials_nine_of_ten_are_within_the_tolerance(tiny_run, tmp_path, monkeypatch, sign):
    rows = rows_of(tiny_run.file, tmp_path / "llvm", variant_or_skip(LLVM).name, 240)
    round_rays_otherwise(monkeypatch, sign)
    monkeypatch.setenv("BORESIGHT_CACHE", str(tmp_path / "cache"))  # images and landmarks of its own
    assert_within_the_tolerance(rows, rows_of(tiny_run.file, tmp_path / "other", LLVM, 240), 0.9)

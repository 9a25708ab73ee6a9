"""A method that hangs, whatever in, is stopped and stored as an error; one that takes its process along as well."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import time
from collections import deque

import pandas as pd
import pytest
from third_party import install_answers
from tiny_campaign import boresight, write_campaign

from boresight.campaign.pool.guard import ENDED, Call, Loss, StoppedError, guarded, guarding, last_call, over_time
from boresight.campaign.pool.workers import in_order
from boresight.campaign.runs.execute import Losses
from boresight.campaign.store import Block
from boresight.campaign.trial.kind import WorkerContext, kind_named, kind_names
from boresight.campaign.trial.runner import Work
from boresight.scenarios.errors import BoresightError

CALL = Call("scene", 3, "mine")


def patient():
    """Catch all that a method may be expected to catch, again and again."""
    while True:
        with contextlib.suppress(Exception):
            time.sleep(60.0)


def test_an_alarm_ends_what_sleeps_and_what_catches_exceptions():
    before = signal.getsignal(signal.SIGALRM)
    for work in (patient, lambda: time.sleep(60.0)):
        began = time.monotonic()
        with guarding(limit_s=0.2), pytest.raises(StoppedError, match=r"longer than the limit of 0.2 s for a trial"):
            guarded(CALL, work)
        assert time.monotonic() - began < 30.0
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_an_alarm_that_is_swallowed_rings_again(monkeypatch):
    monkeypatch.setattr("boresight.campaign.pool.guard._AGAIN_S", 0.1)
    swallowed = []

    def stubborn():
        while True:
            try:
                time.sleep(60.0)
            except BaseException:
                swallowed.append(1)
                if len(swallowed) == 3:
                    raise

    with guarding(limit_s=0.1), pytest.raises(StoppedError):
        guarded(CALL, stubborn)
    assert len(swallowed) == 3


def test_a_note_tells_what_is_under_way_and_is_empty_after(tmp_path):
    note = tmp_path / "note"
    assert last_call(note) is None
    with guarding(note=note):
        assert guarded(CALL, lambda: last_call(note)) == (CALL, "")
    assert last_call(note) is None
    note.write_text(
        '{"scenario": "scene", "trial": 3, "label": "mine"}\nTimeout (0:00:01)!\n  File "x.py", line 7 in f'
    )
    assert last_call(note) == (CALL, 'Timeout (0:00:01)!\n  File "x.py", line 7 in f')
    note.write_text("half of a no")
    assert last_call(note) is None


def test_what_took_its_process_along_is_not_tried_again():
    with guarding(lost={CALL: Loss(ENDED, "where it was")}), pytest.raises(StoppedError) as caught:
        guarded(CALL, lambda: pytest.fail("it is made again"))
    assert str(caught.value) == ENDED
    assert caught.value.__notes__ == ["where it was"]


def arguments(first: int, lost: dict[Call, Loss] | None = None) -> tuple[object, ...]:
    return None, Block("scene", first, first + 2, first // 2), WorkerContext(None, 1, False, limit_s=1.0), lost or {}


def test_a_process_may_end_once_under_a_method_and_not_twice(tmp_path):
    note, told = tmp_path / "note", []
    losses, given = Losses(told.append), [arguments(2), arguments(4)]
    note.write_text('{"scenario": "scene", "trial": 3, "label": "mine"}\n')
    assert losses.after(given, note) == given
    assert losses.after(given, note) == [arguments(2, {CALL: Loss(ENDED, "")}), arguments(4)]
    assert told == [
        "trial 3 of scene, mine: its process ended (killed, or crashed): tried again in another",
        "trial 3 of scene, mine: ended its process again: stored as an error",
    ]


def test_a_method_that_did_not_stop_is_not_tried_again(tmp_path):
    note = tmp_path / "note"
    note.write_text('{"scenario": "scene", "trial": 4, "label": "mine"}\nTimeout (0:00:01)!\nthere')
    late = Call("scene", 4, "mine")
    assert Losses([].append).after([arguments(2), arguments(4)], note) == [
        arguments(2), arguments(4, {late: Loss(over_time(1.0), "Timeout (0:00:01)!\nthere")}),
    ]  # fmt: skip


def test_a_process_that_ends_again_and_again_without_a_method_ends_the_run(tmp_path):
    losses = Losses([].append)
    for _ in range(2):
        assert losses.after([arguments(2)], tmp_path / "none") == [arguments(2)]
    with pytest.raises(BoresightError, match="use fewer --jobs; the same command continues the run"):
        losses.after([arguments(2)], tmp_path / "none")


def spinning_block(campaign, block, bench, lost):
    """Stand for ``run_block``: trial 3 hangs in compiled code that holds the interpreter's lock and hears no signal."""
    with guarding(limit_s=bench.limit_s, lost=lost):
        return [spinning_trial(block.scenario, trial) for trial in range(block.first, block.last)]


def spinning_trial(scenario: str, trial: int):
    def work():
        if trial == 3:
            deque(itertools.repeat(None), maxlen=0)
        return os.getpid()

    judged = Work(Call(scenario, trial, "mine"), "estimator", {"trial": trial}).run(
        work, lambda pid: None, lambda pid: {"rows": [{"trial": trial, "status": "ok", "reason": ""}], "pid": [pid]}
    )
    return judged["rows"][0], judged.get("pid"), judged.get("tracebacks")


def test_a_process_that_hangs_in_compiled_code_is_replaced_and_the_others_go_on():
    told = []
    calls = [arguments(first) for first in (0, 2, 4)]
    blocks = list(in_order(1, spinning_block, calls, apart=True, after_death=Losses(told.append).after))
    trials = [trial for block in blocks for trial in block]
    assert [row["trial"] for row, _, _ in trials] == list(range(6))
    assert [row["status"] for row, _, _ in trials] == ["ok", "ok", "ok", "error", "ok", "ok"]
    assert trials[3][0]["reason"] == f"the estimator was stopped: {over_time(1.0)}"
    assert "in work" in trials[3][2][0]["traceback"], "it tells where it hung"
    assert told == [
        "trial 3 of scene, mine: does not stop when its time is over, so its process was ended: stored as an error"
    ]
    pids = [pid[0] for _, pid, _ in trials if pid]
    assert pids[0] == pids[1] != pids[2] == pids[-1]
    assert os.getpid() not in pids


def unlucky_block(folder, block, _bench, _lost):
    """Stand for ``run_block``: its process ends under a method, the next one before any, the third does not."""
    tries = len(list(folder.iterdir()))
    (folder / str(tries)).touch()
    if tries == 0:
        guarded(CALL, lambda: os._exit(1))
    if tries == 1:
        os._exit(1)
    return [guarded(Call(block.scenario, trial, "mine"), os.getpid) for trial in range(block.first, block.last)]


@pytest.mark.long
def test_a_method_is_not_to_blame_for_a_process_that_ends_before_it(tmp_path):
    told, folder = [], tmp_path / "tries"
    folder.mkdir()
    calls = [(folder, *arguments(2)[1:])]
    (pids,) = in_order(1, unlucky_block, calls, apart=True, after_death=Losses(told.append).after)
    assert len(pids) == 2
    assert told == [
        "trial 3 of scene, mine: its process ended (killed, or crashed): tried again in another",
        "trials 2 to 3 of scene: their process ended: tried again",
    ]


def told_its_process(number):
    return number, os.getpid()


@pytest.mark.long
def test_processes_are_renewed_and_results_stay_in_order():
    found = list(in_order(2, told_its_process, ((n,) for n in range(40)), renew_after=5))
    assert [number for number, _ in found] == list(range(40))
    by_process = pd.Series([pid for _, pid in found]).value_counts()
    assert by_process.max() <= 5
    assert os.getpid() not in by_process.index


@pytest.mark.parametrize("name", kind_names())
def test_no_kind_of_trial_starts_a_process_for_every_block(name):
    kind = kind_named(name)
    assert kind.process_blocks() > 1
    assert kind.process_blocks() * kind.block_trials == kind.process_trials


MODULE = """
import itertools, os, resource, signal, time
from collections import deque
from boresight.estimators.contract import Estimate

def leaks():
    limits = resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm") as pages:
        taken = int(pages.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + (1 << 30), limits[1]))
    kept = []
    try:
        while True:
            kept.append(bytearray(1 << 26))
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)

ANSWERS = {
    "sleeps": lambda: time.sleep(1000),
    "spins": lambda: deque(itertools.repeat(1), maxlen=0),
    "crashes": lambda: os.kill(os.getpid(), signal.SIGSEGV),
    "leaks": leaks,
}

class Method(Base):
    def estimate(self, observation, *, rng):
        if rng.random() < 0.5:
            ANSWERS[self.name]()
        return Estimate("ok", pose=observation.frame.prior_T_cam_body)
"""
REASONS = {
    "sleeps": f"the estimator was stopped: {over_time(3.0)}",
    "spins": f"the estimator was stopped: {over_time(3.0)}",
    "crashes": f"the estimator was stopped: {ENDED}",
    "leaks": "the estimator raised MemoryError",
}


@pytest.mark.long
@pytest.mark.parametrize("where", [("--jobs", 1), ("--jobs", 2), ("--backend", "dask", "--local", 1)])
def test_a_run_goes_on_whatever_its_estimators_do(tmp_path, where):
    if "dask" in where:
        pytest.importorskip("distributed", reason="distributed (the extra dask) is not installed")
    text = f"scenarios: [scene]\nestimators: [prior, {', '.join(REASONS)}]\ntrials: 4\nseed: 5\n"
    install_answers(tmp_path / "site", "estimators", MODULE)
    file, out = write_campaign(tmp_path, text), tmp_path / "run"
    done = boresight("run", file, "--trial-limit", 3, *where, "--out", out, timeout_s=600.0, PYTHONPATH=os.pathsep.join(
        [str(tmp_path / "site"), os.environ.get("PYTHONPATH", "")]))  # fmt: skip
    assert done.returncode == 3, done.stderr
    rows = pd.read_parquet(out / "rows")
    assert len(rows) == 5 * 4
    assert (rows[rows["estimator"] == "prior"]["status"] == "ok").all()
    for name, reason in REASONS.items():
        own = rows[rows["estimator"] == name]
        assert set(own["status"]) == {"ok", "error"}
        assert set(own[own["status"] == "error"]["reason"]) == {reason}

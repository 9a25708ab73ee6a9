"""What methods print and warn of is kept for their trials, and nothing of it reaches the terminal."""

from __future__ import annotations

import ctypes
import logging
import os
import sys
import threading
import warnings

import numpy as np
import pandas as pd
import pytest
from third_party import install_answers
from tiny_campaign import boresight, files
from tiny_sequences import SCENE

from boresight.campaign.cli import main
from boresight.campaign.pool.captured import MOST_CHARACTERS, CapturedOutput
from boresight.campaign.pool.guard import Call
from boresight.campaign.trial.runner import Work

MODULE = """
import logging, os, sys, warnings
import numpy as np
from boresight.estimators.slam.contract import FrameEstimate, SequenceEstimate

for stream in (sys.stdout, sys.stderr):
    logging.getLogger("loud").addHandler(logging.StreamHandler(stream))

class Method(Base):
    def follow(self, sequence):
        for k in range(1000):
            print("LOUD", k)
        print("to stderr", file=sys.stderr)
        logging.getLogger("loud").warning("LOUD log")
        os.write(1, b"LOUD descriptor\\n")
        os.system("echo LOUD process >&2")
        np.log(np.zeros(3))
        warnings.warn("as expected")
        if self.name == "fails":
            raise ValueError("after all")
        frame = FrameEstimate(np.full(3, 800.0), None, np.zeros(0, np.int64), np.zeros((0, 3)), 0.1)
        return SequenceEstimate("ok", (frame,) * len(sequence.frames))

ANSWERS = {
    "loud": None,
    "fails": None,
}
"""


@pytest.fixture
def loud(tmp_path, monkeypatch):
    """A campaign of two estimators that say much; return its file, with the package in the way of Python."""
    install_answers(tmp_path, "sequence_estimators", MODULE, monkeypatch)
    (tmp_path / "scene.yaml").write_text(SCENE)
    text = "experiment: sequence\nscenarios: [scene]\nestimators: [loud, fails]\ntrials: 6\nseed: 5\n"
    (tmp_path / "loud.yaml").write_text(text)
    return tmp_path / "loud.yaml"


@pytest.mark.filterwarnings("default")
def test_what_estimators_say_is_kept_for_their_trials(loud, tmp_path, capfd):
    out = tmp_path / "run"
    assert main(["run", str(loud), "--jobs", "1", "--worst", "0", "--out", str(out)]) == 3
    told = capfd.readouterr()
    assert "LOUD" not in told.out + told.err
    assert told.err == ""
    assert "printed or warned in trials: loud in 6, fails in 6" in told.out
    said = pd.read_parquet(out / "said")
    assert len(said) == 2 * 6 * 3
    texts = said[said["trial"] == 5].set_index(["estimator", "stream"])["text"]
    assert texts["loud", "stdout"].startswith("LOUD 0\nLOUD 1\n")
    length = sum(len(f"LOUD {k}\n") for k in range(1000))
    length += len("LOUD log\nLOUD descriptor\n")
    assert texts["loud", "stdout"].endswith(f"[cut here: {length - MOST_CHARACTERS:,} more characters]")
    assert texts["fails", "stderr"] == "to stderr\nLOUD log\nLOUD process\n"
    for words in ("RuntimeWarning: divide by zero", "UserWarning: as expected"):
        assert words in texts["loud", "warnings"], "in every trial, not only in the first"
    assert main(["inspect", str(out), "--trial", "5", "--estimator", "loud"]) == 0
    assert "LOUD" not in capfd.readouterr().out
    page = (out / "inspect" / "scene_loud_0000005" / "index.html").read_text()
    assert "What the method wrote" in page
    assert "LOUD 3" in page


@pytest.mark.long
@pytest.mark.filterwarnings("default")
def test_what_estimators_say_in_workers_is_kept_too(loud, tmp_path):
    out = tmp_path / "run"
    assert main(["run", str(loud), "--jobs", "1", "--no-report", "--out", str(out)]) == 3
    said = pd.read_parquet(out / "said")
    done = boresight("run", loud, "--jobs", 2, "--out", tmp_path / "two", PYTHONPATH=str(tmp_path))
    assert done.returncode == 3, done.stderr
    assert "LOUD" not in done.stdout + done.stderr
    assert files(tmp_path / "two", "rows", "epochs") == files(out, "rows", "epochs")
    assert sorted(pd.read_parquet(tmp_path / "two" / "said")["text"]) == sorted(said["text"])


def test_a_silent_method_leaves_nothing():
    captured = CapturedOutput()
    with captured.capturing():
        pass
    assert captured.records() == {}


def test_other_threads_are_passed_on_and_streams_stay_open(capsys):
    captured, go, gone = CapturedOutput(), threading.Event(), threading.Event()

    def bar():
        go.wait(10)
        sys.stdout.write("bar\n")
        gone.set()

    other = threading.Thread(target=bar)
    other.start()
    with captured.capturing():
        go.set()
        assert gone.wait(10)
        mine = threading.Thread(target=lambda: sys.stdout.write("of mine\n"))
        mine.start()
        mine.join()
        sys.stdout.write("\ud800")
        sys.stdout.close()
    other.join()
    sys.stdout.write("still open\n")
    assert capsys.readouterr().out == "bar\nstill open\n"
    assert captured.records() == {"said": [{"stream": "stdout", "text": "of mine\n?"}]}


def test_what_passes_pythons_streams_by_is_captured_up_to_the_limit(capfd):
    captured, log = CapturedOutput(), logging.getLogger("passes by")
    handlers = [logging.StreamHandler(stream) for stream in (sys.stderr, sys.stdout)]
    for handler in handlers:
        log.addHandler(handler)
    library = ctypes.CDLL(None)
    for _ in range(2):
        with captured.capturing():
            os.write(2, b"descriptor\n")
            library.puts(b"compiled")
            log.error("log")
            handlers.append(logging.StreamHandler())
            log.addHandler(handlers[-1])
        captured, first = CapturedOutput(), captured
    log.error("after")
    for handler in handlers:
        log.removeHandler(handler)
    os.write(1, b"still open\n")
    said = {one["stream"]: one["text"] for one in first.records()["said"]}
    assert said == {"stdout": "log\ncompiled\n", "stderr": "log\nlog\ndescriptor\n"}
    told = capfd.readouterr()
    assert told.out == "after\nstill open\n"
    assert told.err == "after\n" * 3
    with captured.capturing():
        os.write(1, b"x" * (5 * MOST_CHARACTERS))
    (one,) = captured.records()["said"]
    assert one["text"] == "x" * MOST_CHARACTERS + f"\n[cut here: {4 * MOST_CHARACTERS:,} more characters]"


def test_other_threads_reach_the_terminal_while_the_descriptors_are_led_away(capfd, monkeypatch):
    with open(1, "w", closefd=False) as terminal:
        monkeypatch.setattr(sys, "stdout", terminal)
        go, gone, captured = threading.Event(), threading.Event(), CapturedOutput()

        def bar():
            go.wait(10)
            sys.stdout.write("bar\n")
            sys.stdout.flush()
            gone.set()

        thread = threading.Thread(target=bar)
        thread.start()
        with captured.capturing():
            os.write(1, b"mine\n")
            go.set()
            assert gone.wait(10)
        thread.join()
    assert capfd.readouterr().out == "bar\n"
    assert captured.records() == {"said": [{"stream": "stdout", "text": "mine\n"}]}


def test_in_another_thread_descriptors_stay_and_logs_are_captured(capfd):
    captured, log, handler = CapturedOutput(), logging.getLogger("of dask"), logging.StreamHandler(sys.stderr)
    log.addHandler(handler)

    def work():
        with captured.capturing():
            log.error("log")
            os.write(1, b"descriptor\n")

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    log.removeHandler(handler)
    assert captured.records() == {"said": [{"stream": "stderr", "text": "log\n"}]}
    assert capfd.readouterr() == ("descriptor\n", "")


def test_a_warning_that_is_to_be_an_error_stays_one():
    def work():
        warnings.warn("no more", UserWarning, stacklevel=1)
        return np.ones(1)

    found = Work(Call("scene", 0, "mine"), "estimator", {}).run(work, lambda _: None, lambda _: {"rows": [{}]})
    assert found["rows"][0]["reason"] == "the estimator raised UserWarning: no more"

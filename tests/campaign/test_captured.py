"""What methods print and warn of is kept for their trials, and nothing of it reaches the terminal."""

from __future__ import annotations

import sys
import threading
import warnings

import numpy as np
import pandas as pd
import pytest
from test_rubbish import install
from tiny_campaign import boresight, files
from tiny_sequences import SCENE

from campaign.captured import MOST_CHARACTERS, Captured
from campaign.cli import main
from campaign.experiments.fault import Work
from campaign.guard import Call

MODULE = """
import sys, warnings
import numpy as np
from estimators.slam.contract import FrameEstimate, SequenceEstimate

class Rubbish:
    version = 1
    @classmethod
    def from_options(cls, options):
        return cls()
    def follow(self, sequence):
        for k in range(1000):
            print("LOUD", k)
        print("to stderr", file=sys.stderr)
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
for _name in ANSWERS:
    globals()["made_" + _name] = type(_name, (Rubbish,), {"name": _name})
"""


@pytest.fixture
def loud(tmp_path, monkeypatch):
    """A campaign of two estimators that say much; return its file, with the package in the way of Python."""
    install(tmp_path, "sequence_estimators", MODULE, monkeypatch)
    (tmp_path / "scene.yaml").write_text(SCENE)
    text = "experiment: sequence\nscenarios: [scene]\nestimators: [loud, fails]\ntrials: 6\nseed: 5\n"
    (tmp_path / "loud.yaml").write_text(text)
    return tmp_path / "loud.yaml"


@pytest.mark.filterwarnings("default")
def test_what_estimators_say_is_kept_for_their_trials(loud, tmp_path, capsys):
    out = tmp_path / "run"
    assert main(["run", str(loud), "--jobs", "1", "--worst", "0", "--out", str(out)]) == 3
    told = capsys.readouterr()
    assert "LOUD" not in told.out + told.err
    assert told.err == ""
    assert "printed or warned in trials: loud in 6, fails in 6" in told.out
    said = pd.read_parquet(out / "said")
    assert len(said) == 2 * 6 * 3
    texts = said[said["trial"] == 5].set_index(["estimator", "stream"])["text"]
    assert texts["loud", "stdout"].startswith("LOUD 0\nLOUD 1\n")
    length = sum(len(f"LOUD {k}\n") for k in range(1000))
    assert texts["loud", "stdout"].endswith(f"[cut here: {length - MOST_CHARACTERS:,} more characters]")
    assert texts["fails", "stderr"] == "to stderr\n"
    for words in ("RuntimeWarning: divide by zero", "UserWarning: as expected"):
        assert words in texts["loud", "warnings"], "in every trial, not only in the first"
    assert main(["inspect", str(out), "--trial", "5", "--estimator", "loud"]) == 0
    assert "LOUD" not in capsys.readouterr().out
    page = (out / "inspect" / "scene_loud_0000005" / "index.html").read_text()
    assert "What the method wrote" in page
    assert "LOUD 3" in page
    assert boresight("run", loud, "--jobs", 2, "--out", tmp_path / "two", PYTHONPATH=str(tmp_path)).returncode == 3
    assert files(tmp_path / "two", "rows", "epochs") == files(out, "rows", "epochs")
    assert sorted(pd.read_parquet(tmp_path / "two" / "said")["text"]) == sorted(said["text"])


def test_a_silent_method_leaves_nothing():
    captured = Captured()
    with captured.capturing():
        pass
    assert captured.records() == {}


def test_other_threads_are_passed_on_and_streams_stay_open(capsys):
    captured, go, gone = Captured(), threading.Event(), threading.Event()

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


def test_a_warning_that_is_to_be_an_error_stays_one():
    def work():
        warnings.warn("no more", UserWarning, stacklevel=1)
        return np.ones(1)

    found = Work(Call("scene", 0, "mine"), "estimator", {}).judged(work, lambda _: None, lambda _: {"rows": [{}]})
    assert found["rows"][0]["reason"] == "the estimator raised UserWarning: no more"

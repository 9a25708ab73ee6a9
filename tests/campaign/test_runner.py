"""The runner of trials on a made-up kind: methods halve a number, and are scored by what is missing."""

from __future__ import annotations

from dataclasses import dataclass, field
from decimal import Decimal
from types import SimpleNamespace

import pytest

from boresight.campaign.trial.kind import PerDatabase
from boresight.campaign.trial.runner import TrialRunner, Unbuilt
from boresight.scenarios.errors import UndrawableError


class _NoNumberError(UndrawableError):
    pass


@dataclass(frozen=True, eq=False, kw_only=True)
class Halves(TrialRunner):
    name, version, block_trials = "halves", 1, 4
    called, undrawable_reason = "halver", "no number"

    flushed: list[int] = field(default_factory=list)

    method_version = check_scenario = build_methods = open = None

    def draw(self, trial):
        if trial == 3:
            raise _NoNumberError("three is left out")
        return float(trial)

    def row(self, drawn):
        return {"number": drawn, "status": "?"}

    def ask(self, method, drawn):
        return method(drawn)

    def check(self, answer, drawn):
        if answer > drawn:
            raise ValueError("too large")

    def score(self, answer, drawn):
        return {"rows": [{"status": "ok", "reason": "", "error": answer - 0.5 * drawn}], "halves": [{"half": answer}]}

    def of_draw(self, drawn):
        return {"numbers": [{"number": drawn}]}

    def of_all(self, drawn):
        return {"timings": [{"seconds": 1.0}]}

    def shown(self, answer, drawn):
        return SimpleNamespace(estimate=answer, truth=drawn)

    def flush(self):
        self.flushed.append(1)


METHODS = {"half": lambda x: 0.5 * x, "double": lambda x: 2.0 * x + 1.0, "none": Unbuilt("there is none", "why")}


def halves(methods=METHODS, **changes):
    return Halves(scenario="s", methods=methods, seed=7, **changes)


def test_each_method_is_asked_about_each_draw_in_order():
    trials = halves(database={"half": 2})
    found = trials.run(range(3))
    keys = [(row["trial"], row["estimator"], row["status"]) for row in found["rows"]]
    assert keys == [(t, m, s) for t in range(3) for m, s in (("half", "ok"), ("double", "error"), ("none", "error"))]
    assert found["rows"][3] == {
        **{"trial": 1, "scenario": "s", "estimator": "half", "image": "", "number": 1.0},
        **{"status": "ok", "reason": "", "error": 0.0, "database": 2},
    }
    reasons = [row["reason"] for row in found["rows"][4:6]]
    assert reasons == [
        "the halver returned an invalid result: too large",
        "the halver cannot work: there is none",
    ]
    assert [row["database"] for row in found["rows"][3:6]] == [2, None, None]
    assert found["numbers"] == [{"trial": t, "scenario": "s", "number": float(t)} for t in range(3)]
    assert [line["half"] for line in found["halves"]] == [0.0, 0.5, 1.0]
    assert [(line["trial"], line["estimator"]) for line in found["timings"]] == [key[:2] for key in keys]
    assert trials.flushed == [1]


def test_a_draw_that_is_lost_is_a_failure_of_all():
    rows = halves(database={"half": 2}).trial(3)
    failed = {"image": "", "status": "failed", "reason": "no number: three is left out", "n_landmarks": 0}
    key = {"trial": 3, "scenario": "s"}
    assert rows == {
        "rows": [{**key, "estimator": m, **failed, "database": 2 if m == "half" else None} for m in METHODS]
    }


def test_one_method_is_watched_alone():
    shown = []
    for label in METHODS:
        watched = halves().watched(label, shown.append)
        assert watched.trial(1)["rows"] == [row for row in halves().trial(1)["rows"] if row["estimator"] == label]
    assert [(one.estimate, one.truth) for one in shown] == [(0.5, 1.0), (None, 1.0), (None, 1.0)]


def test_what_scoring_raises_ends_the_run():
    with pytest.raises(TypeError) as caught:
        halves({"decimal": lambda x: Decimal(0)}).trial(1)
    assert "error of boresight" in caught.value.__notes__[0]


def test_trials_take_their_data_bases_in_turn():
    parts = tuple(halves({"half": METHODS["half"]}, database={"half": number}) for number in range(3))
    every = PerDatabase(parts)
    found = every.run(range(4, 9))
    assert [(row["trial"], row["database"]) for row in found["rows"]] == [(4, 1), (5, 2), (6, 0), (7, 1), (8, 2)]
    assert every.of(5) is parts[2]
    assert [part.flushed for part in parts] == [[1]] * 3
    alone = PerDatabase(parts[:1])
    assert [row["database"] for row in alone.run(range(2))["rows"]] == [0, 0]

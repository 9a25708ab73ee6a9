"""Rubbish of methods of third parties goes through every command: rows say so, nothing of it is drawn, none ends."""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd
import pytest
from tiny_campaign import SCENE, run, write_campaign

from boresight.campaign.cli import main

IMAGES = """
import numpy as np
from boresight.estimators.contract import Estimate, Stage
from boresight.scenarios.geometry import Pose

class Falls:
    def __len__(self):
        return 1
    def __iter__(self):
        raise SystemExit("fell")

def endless(prior):
    while True:
        yield Stage("again", prior)

ANSWERS = {
    "matrix": lambda prior: Estimate("ok", pose=np.eye(4)),
    "matrix-failed": lambda prior: Estimate("failed", "late", pose=np.eye(4)),
    "nothing": lambda prior: None,
    "text": lambda prior: "ok",
    "table": lambda prior: {"status": "ok", "pose": prior},
    "none": lambda prior: Estimate("ok"),
    "several": lambda prior: Estimate("ok", pose=(prior,)),
    "nan": lambda prior: Estimate("ok", pose=Pose(prior.rotation, [np.nan, 0, 0])),
    "complex": lambda prior: Estimate("ok", pose=prior, covariance=1j * np.eye(6)),
    "skew": lambda prior: Estimate("ok", pose=prior, covariance=np.triu(np.ones((6, 6)))),
    "huge": lambda prior: Estimate("ok", pose=Pose(prior.rotation, [0, 0, 1e200])),
    "falls": lambda prior: Estimate("ok", pose=prior, stages=Falls()),
    "endless": lambda prior: Estimate("failed", "on and on", stages=endless(prior)),
    "objects": lambda prior: Estimate("ok", pose=prior, details={"mine": {"a": np.array([object()])}}),
    "keys": lambda prior: Estimate("ok", pose=prior, diagnostics={(1, 2): 3.0}),
}

class Rubbish:
    version = 1
    @classmethod
    def from_options(cls, options, assets):
        return cls()
    def estimate(self, observation, *, rng):
        return ANSWERS[self.name](observation.frame.prior_T_cam_body)

for _name in ANSWERS:
    globals()["made_" + _name.replace("-", "_")] = type(_name, (Rubbish,), {"name": _name})
"""
SEQUENCES = """
import numpy as np
from boresight.estimators.slam.contract import FrameEstimate, SequenceEstimate

NONE = np.zeros(0, np.int64), np.zeros((0, 3)), 0.1

def ok(position=np.ones(3), covariance=None):
    return lambda n: SequenceEstimate("ok", (FrameEstimate(position, covariance, *NONE),) * n)

ANSWERS = {
    "matrix": ok(np.eye(4)),
    "nothing": lambda n: None,
    "text": lambda n: "ok",
    "table": lambda n: {"frames": []},
    "nan": ok(np.full(3, np.nan)),
    "few": lambda n: ok()(n - 1),
    "many": lambda n: ok()(n + 1),
    "complex": ok(1j * np.ones(3)),
    "skew": ok(covariance=np.triu(np.ones((3, 3)))),
    "huge": ok(np.full(3, 1e200)),
    "generator": lambda n: SequenceEstimate("failed", (frame for frame in ok()(n).frames), "late"),
    "objects": lambda n: SequenceEstimate("ok", (object(),) * n),
    "keys": lambda n: SequenceEstimate("ok", ok()(n).frames, diagnostics={(1, 2): 3.0}),
}

class Rubbish:
    version = 1
    @classmethod
    def from_options(cls, options):
        return cls()
    def follow(self, sequence):
        return ANSWERS[self.name](len(sequence.frames))

for _name in ANSWERS:
    globals()["made_" + _name] = type(_name, (Rubbish,), {"name": _name})
"""
ORBITING = "extends: apophis-sphere-sequence\nsequence: {orbit: {revolutions: 0.05}}\n"
KINDS = {
    "estimators": (IMAGES, SCENE, "prior"),
    "sequence_estimators": (SEQUENCES, ORBITING, "dead-reckoning"),
}


def install(folder: Path, group: str, module: str, patch: pytest.MonkeyPatch) -> list[str]:
    """Leave a package of these methods as pip would; return their names."""
    name = f"rubbish_of_{group}"
    (folder / f"{name}.py").write_text(module)
    names = [line.split('"')[1] for line in module.splitlines() if line.startswith('    "')]
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = [f"{one} = {name}:made_{one.replace('-', '_')}" for one in names]
    (info / "entry_points.txt").write_text("\n".join([f"[boresight.{group}]", *lines]) + "\n")
    patch.syspath_prepend(str(folder))
    patch.delitem(sys.modules, name, raising=False)
    return names


@pytest.mark.parametrize(
    ("group", "worst"),
    [("estimators", 0), ("sequence_estimators", 0), *(pytest.param(name, 1, marks=pytest.mark.long) for name in KINDS)],
)
def test_rubbish_ends_no_command(group, worst, cache, tmp_path, monkeypatch, capsys):
    module, scene, control = KINDS[group]
    names = install(tmp_path, group, module, monkeypatch)
    kind = "experiment: sequence\n" if group.startswith("sequence") else ""
    text = f"title: R\n{kind}scenarios: [scene]\nestimators: [{control}, {', '.join(names)}]\ntrials: 1\nseed: 5\n"
    file, out = write_campaign(tmp_path / "campaign", text, scene), str(tmp_path / "run")
    assert run(file, out, "--worst", worst) == 3
    rows = pd.read_parquet(f"{out}/rows").set_index("estimator")
    assert rows.loc[names, "status"].eq("error").all()
    assert rows.loc[names, "reason"].str.startswith("the estimator returned an invalid result: ").all()
    for name in ("matrix", "falls" if group == "estimators" else "generator"):
        assert main(["inspect", out, "--trial", "0", "--estimator", name]) == 0
    assert not list(Path(out, "inspect").glob("*/estimate.json")), "nothing of it is kept as an answer"
    assert main(["inspect", out, "--look", "--estimator", "matrix"]) in (0, 2)
    for command in ("compare", "export --to csv", "export --to latex", "export --to tum", "export --to colmap"):
        words = command.split()
        assert main([words[0], out, *words[1:], "--out", str(tmp_path / words[-1])]) in (0, 2)
    assert main(["status", out]) == 0
    said = capsys.readouterr()
    assert "Traceback" not in said.out + said.err
    assert len(said.err.splitlines()) <= 8, "at most a line for each command"


ABSURD = """
import numpy as np
from boresight.estimators.contract import Estimate
from boresight.scenarios.geometry import Pose

NAMES = "u_px v_px x_m y_m z_m sxx_m2 sxy_m2 sxz_m2 syy_m2 syz_m2 szz_m2".split()
TABLE = {"landmark": np.arange(2), **{name: np.full(2, float(name[1:3] in ("xx", "yy", "zz"))) for name in NAMES}}
ANSWERS = {
    "behind": lambda prior: -prior.translation_m,
    "inside": lambda prior: np.zeros(3),
}

class Absurd:
    version = 1
    @classmethod
    def from_options(cls, options, assets):
        return cls()
    def estimate(self, observation, *, rng):
        prior = observation.frame.prior_T_cam_body
        pose = Pose(prior.rotation, ANSWERS[self.name](prior))
        return Estimate("ok", pose=pose, details={"landmarks": TABLE})

for _name in ANSWERS:
    globals()["made_" + _name] = type(_name, (Absurd,), {"name": _name})
"""


def test_what_keeps_the_contract_and_is_absurd_is_drawn_as_far_as_it_can_be(cache, tmp_path, monkeypatch, capsys):
    names = install(tmp_path, "estimators", ABSURD, monkeypatch)
    text = f"title: A\nscenarios: [scene]\nestimators: [{', '.join(names)}]\ntrials: 1\nseed: 5\n"
    file, out = write_campaign(tmp_path / "campaign", text, SCENE), tmp_path / "run"
    assert run(file, out) == 0
    assert main(["inspect", str(out), "--trial", "0"]) == 0
    drawn = {name: {path.stem for path in (out / "inspect" / f"scene_{name}_0000000").glob("*.png")} for name in names}
    assert drawn == {"behind": {"poses"}, "inside": {"poses"}}, "landmarks behind the camera have no place in an image"
    page = (out / "inspect" / "scene_inside_0000000" / "index.html").read_text()
    assert "Nothing can be rendered at the estimate" in page

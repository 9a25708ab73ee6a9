"""Crater detectors by name: the built-in ones, and third-party ones by their entry points."""

from __future__ import annotations

import sys

import pytest

from boresight.estimators.craters.detection.classic import CraterClassic
from boresight.estimators.craters.registry import crater_detector_class, crater_detector_names
from boresight.scenarios.errors import BoresightError

MODULE = """
from dataclasses import dataclass
from boresight.estimators.craters.contract import CraterDetections
from boresight.scenarios.geometry import Ellipses
import numpy as np

@dataclass(frozen=True)
class Blind:
    name = "blind"
    version = 1

    @classmethod
    def from_options(cls, options):
        return cls()

    def detect(self, frame, camera):
        return CraterDetections(Ellipses.none(), np.empty(0))
"""


def install(folder, monkeypatch, module, line):
    """Write a package of one module to a folder as pip would."""
    (folder / "my_craters.py").write_text(module, encoding="utf-8")
    info = folder / "my_craters-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my_craters\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[boresight.crater_detectors]\n{line}\n")
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "my_craters", raising=False)


@pytest.mark.parametrize("name", crater_detector_names())
def test_each_name_is_its_class_and_refuses_an_unknown_option(name):
    found = crater_detector_class(name)
    assert found.name == name
    with pytest.raises(
        BoresightError, match=rf"estimator {name}: no_such_thing: unknown key; known here are .*window_px"
    ):
        found.from_options({"no_such_thing": 1})


def test_a_third_partys_detector_is_found(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, MODULE, "blind = my_craters:Blind")
    assert "blind" in crater_detector_names()
    assert len(crater_detector_class("blind").from_options({}).detect(None, None).ellipses) == 0


def test_a_name_of_ours_stays_ours(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, MODULE, "crater-classic = my_craters:Blind")
    assert crater_detector_class("crater-classic") is CraterClassic


@pytest.mark.parametrize(
    ("module", "said"),
    [
        ("class Blind: name, version = 'blind', 1", r"'blind' \(my_craters:Blind\) lacks from_options, detect"),
        ("import not_there", "cannot be imported from my_craters:Blind: No module named 'not_there'"),
    ],
)
def test_what_does_not_follow_the_contract_is_named(tmp_path, monkeypatch, module, said):
    install(tmp_path, monkeypatch, module, "blind = my_craters:Blind")
    with pytest.raises(BoresightError, match=said):
        crater_detector_class("blind")


def test_an_unknown_name_is_told_what_there_is():
    with pytest.raises(BoresightError, match="'crater-clasic' is unknown; did you mean crater-classic"):
        crater_detector_class("crater-clasic")

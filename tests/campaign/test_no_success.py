"""Every kind of run is reported and compared where no trial has an answer, and where one has."""

from __future__ import annotations

import pytest
from test_paper_cheng import CRATERED, ORBIT
from tiny_campaign import SCENE, write_campaign
from tiny_pairs import PAIRS

from boresight.campaign.cli import main
from boresight.campaign.trial import runner as fault

ORBITING = "extends: apophis-sphere-sequence\nsequence: {orbit: {revolutions: 0.1}}\n"
OF_SEQUENCES = "experiment: sequence\nestimators: [dead-reckoning]\n"
LANDMARKS = "{lm: {label: landmarks, key: sequence.vision.landmarks_per_frame, values: [8, 12]}}"
RANGES = "range: {label: range, key: viewpoint.range_m, values: [2000, 2500]}"
ANGLES = "fov: {label: field, key: camera.fov_deg, values: [18, 20]}"
KINDS = {
    "images": (SCENE, "estimators: [prior]\n"),
    "levels": (SCENE, f"estimators: [prior]\ngrid: {{design: two-level, axes: {{{RANGES}, {ANGLES}}}}}\n"),
    "series": (ORBITING, f"{OF_SEQUENCES}grid: {{design: full, axes: {LANDMARKS}}}\n"),
    "one-at-a-time": (ORBITING, f"{OF_SEQUENCES}grid: {{design: one-at-a-time, axes: {LANDMARKS}}}\n"),
    "detection": (
        CRATERED.replace("known_diameter_m: 30", "known_diameter_m: 20"),
        "experiment: crater-detection\nestimators: [crater-classic]\n",
    ),
    "matching": (PAIRS, "experiment: crater-matching\nestimators: [vote]\n"),
    "orbits": (ORBIT, "experiment: orbit-determination\nestimators: [batch-filter]\n"),
}


@pytest.mark.parametrize(
    ("kind", "answers"),
    [
        *(("images", 0), ("levels", 0), ("series", 0), ("series", 1), ("one-at-a-time", 0)),
        *(("detection", 0), ("matching", 1), ("orbits", 0)),
    ],
)
def test_a_run_without_success_is_told_of(kind, answers, cache, tmp_path, monkeypatch, capsys):
    really = fault.guarded

    def failing(call, work):
        if call.trial >= answers:
            raise RuntimeError(f"of trial {call.trial}")
        return really(call, work)

    monkeypatch.setattr(fault, "guarded", failing)
    scene, text = KINDS[kind]
    head, out = "title: T\nscenarios: [scene]\ntrials: 2\nseed: 4\n", tmp_path / "run"
    file = write_campaign(tmp_path, head + text, scene)
    assert main(["run", str(file), "--jobs", "1", "--worst", "1", "--out", str(out)]) == 3
    assert main(["compare", str(out), "--out", str(tmp_path / "compared")]) in (0, 2)
    assert main(["status", str(out)]) == 0
    said = capsys.readouterr()
    assert len(said.err.splitlines()) <= 1, "one line for a comparison that has nothing to go by"

"""`boresight sensitivity`: what varies moves the errors, what is not applied is told, what is wrong is one line."""

from __future__ import annotations

import pandas as pd
import pytest
from tiny_campaign import CAMPAIGN, write_campaign

from campaign.cli import main


def sensitivity(file, out, *arguments):
    return main(["sensitivity", str(file), "--jobs", "1", "--out", str(out), *map(str, arguments)])


@pytest.mark.usefixtures("cache")
def test_a_key_that_changes_nothing_is_told(tmp_path, capsys):
    file, out = write_campaign(tmp_path), tmp_path / "run"
    over = ("--over", "pose_error.attitude.angle_deg.max=0.1:20", "--over", "sensors.altimeter.sigma_m=1:10")
    design = ("--method", "latin-hypercube", "--samples", 4, "--trials", 3)
    assert sensitivity(file, out, *over, *design) == 0
    said = capsys.readouterr().out
    assert "sensors.altimeter.sigma_m changes no result of landmark-harris" in said
    assert "angle_deg.max changes no result" not in said
    samples = pd.read_csv(out / "sensitivity" / "samples.csv")
    assert len(samples) == 4
    assert len(set(samples["landmark-harris"])) > 1
    rows = pd.read_parquet(out / "rows")
    # Each sample is a scenario with the draws of the base: attitude errors in proportion to the bound.
    base, first = (rows[rows["scenario"] == name].query("estimator == 'prior'") for name in ("base", "sample-00001"))
    bound = samples["pose_error.attitude.angle_deg.max"][0]
    ratio = first["prior_attitude_error_deg"].to_numpy() / base["prior_attitude_error_deg"].to_numpy()
    assert ratio == pytest.approx(bound / 2.0)
    for name in ("sensitivity.md", "sensitivity.png", "sensitivity.pdf", "indices.csv"):
        assert (out / "sensitivity" / name).stat().st_size > 100


@pytest.mark.parametrize(
    ("over", "further", "why"),
    [
        (["camera.fov_dge=3:4"], (), "unknown key"),
        (["camera.fov_deg=3"], (), "KEY=LOW:HIGH"),
        (["camera.fov_deg=10:20", "camera.fov_deg=1:2"], (), "named twice"),
        (["camera.fov_deg=10:20"], ("--samples", "12"), "power of two"),
        (["camera.fov_deg=10:20"], ("--metric", "speed"), "--metric speed: choose one of position_error_m"),
        (["camera.fov_deg=10:20"], ("--statistic", "mode"), "--statistic mode: choose one of median"),
        (["camera.fov_deg=10:2000"], ("--samples", "2"), "fov_deg"),
    ],
)
def test_what_is_wrong_is_one_line(tmp_path, capsys, over, further, why):
    words = [word for text in over for word in ("--over", text)]
    assert sensitivity(write_campaign(tmp_path), tmp_path / "run", *words, *further) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1, error
    assert why in error
    assert not (tmp_path / "run").exists()


def test_a_campaign_of_several_scenarios_is_refused(tmp_path, capsys):
    (tmp_path / "two.yaml").write_text("extends: scene.yaml\n")
    file = write_campaign(tmp_path, CAMPAIGN.replace("[scene]", "[scene, two.yaml]"))
    assert sensitivity(file, tmp_path / "run", "--over", "camera.fov_deg=10:20") == 2
    assert "has 2 scenarios; a sensitivity analysis varies one" in capsys.readouterr().err

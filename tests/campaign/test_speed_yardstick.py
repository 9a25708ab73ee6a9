"""Works without a peer: their times beside the yardstick, and the memory of large ones."""

import re
from functools import partial

import numpy as np
import pytest
from benchmarks import methods, size
from benchmarks.methods import METHODS, SEQUENCES, combined_ratios, crater_ratios, method_ratios
from benchmarks.ratio import SpeedTable, checked
from benchmarks.size import size_ratios
from benchmarks.timing import YARDSTICK, Seconds, Settings
from stored_grids import store_wide

from boresight.campaign.runs.resolve import resolve
from boresight.renderers.mitsuba3 import choose_variant
from boresight.scenarios.errors import BoresightError


def test_every_method_and_prediction_has_a_ratio_by_processor_time(cache):
    found = list(method_ratios(Settings(rounds=1, views=1)))
    assert [ratio.work for ratio in found] == [
        "limb, image of 1024 x 1024", "limb, prediction of an image", "stars, image of 1024 x 1024",
        "fixed-lag, prediction of 361 frames",
    ]  # fmt: skip
    assert {(ratio.peer, ratio.clock, ratio.same_run) for ratio in found} == {(YARDSTICK, "cpu", True)}
    assert all(1e-4 < ratio.ours_s < 1.0 and 1e-3 < ratio.peer_s < 0.1 for ratio in found)
    assert found[1].ours_s < found[0].ours_s, "a prediction looks at no image"


def test_a_sequence_has_as_many_frames_as_its_work_is_named_for():
    (scenario,) = resolve(SEQUENCES, (), variant=choose_variant().name).scenarios
    assert scenario.spec.sequence.orbit.frames == 361


def test_the_ratio_is_of_the_means_of_least_times(monkeypatch):
    clock = {"one": iter([9.0, 9.0, 0.3, *[0.5] * 4]), "other": iter([9.0, 9.0, *[0.5] * 5])}
    monkeypatch.setattr(methods, "timed", lambda work: lambda: Seconds(work(), 0.0))
    monkeypatch.setattr(methods, "yardstick", lambda: Seconds(0.2, 0.0))
    ratio = methods._beside_yardstick("w", [partial(next, clock["one"]), partial(next, clock["other"])], 5.0, 5)
    assert (ratio.ours_s, ratio.peer_s) == pytest.approx((0.4, 0.2))
    assert "2 trials" in ratio.agreement and ratio.aim is None


def test_the_time_of_a_method_that_fails_is_refused(cache, monkeypatch):
    """Of a white plate of 2e6 electrons a second no star is bright enough: nothing to identify, in little time."""
    scene, aim_ms = METHODS["stars"]
    monkeypatch.setattr(methods, "METHODS", {"stars": (scene.replace("1.0e+8", "2.0e+6"), aim_ms)})
    with pytest.raises(BoresightError, match=r"stars, image .*: trial 0 failed \(0 point sources"):
        next(method_ratios(Settings(rounds=1, views=1)))


def test_detectors_and_what_is_built_on_other_methods_have_ratios(cache, monkeypatch):
    """On images of a sixteenth of the pixels, which cost less."""
    small = methods.CRATER_SCENE.replace("1024", "256").replace("min_diameter_m: 16", "min_diameter_m: 40")
    monkeypatch.setattr(methods, "CRATER_SCENE", small)
    found = [*crater_ratios(Settings(rounds=1, views=1)), *combined_ratios(Settings(rounds=1, views=1))]
    assert [ratio.work.split(",")[0] for ratio in found] == [
        "crater-learned", "crater-heat-map", "consensus of limb and photometric", "tuned",
    ]  # fmt: skip
    assert {(ratio.peer, ratio.clock, ratio.same_run) for ratio in found} == {(YARDSTICK, "cpu", True)}
    assert all(1e-2 < ratio.ours_s < 20.0 for ratio in found)


def test_the_time_of_a_detector_that_finds_nothing_is_refused(cache, monkeypatch):
    """From four times as far in a small image, no crater is large enough."""
    far = methods.CRATER_SCENE.replace("1024", "64").replace("range_m: 2000", "range_m: 8000")
    monkeypatch.setattr(methods, "CRATER_SCENE", far)
    with pytest.raises(BoresightError, match="crater-learned: it finds no crater"):
        next(crater_ratios(Settings(rounds=1, views=1)))


def test_the_time_of_a_consensus_of_which_one_method_fails_is_refused(cache, monkeypatch):
    """An exposure of a nanosecond shows no body."""
    dark = methods.COMBINED_SCENE.replace("exposure_s: 0.1", "exposure_s: 1.0e-9")
    monkeypatch.setattr(methods, "COMBINED_SCENE", dark)
    with pytest.raises(BoresightError, match=r"consensus of limb .*: trial 0 failed"):
        next(combined_ratios(Settings(rounds=1, views=1)))


def test_memory_is_that_of_the_work_and_not_of_who_asks():
    held = np.ones(2**27)
    cpu_s, fixed_s, peak_gib = size.measured_in_a_process(partial(np.ones, 2**26))
    assert 0.5 < peak_gib < held.nbytes / 2**30
    assert cpu_s > 0.0
    assert 1e-3 < fixed_s < 0.1


@pytest.mark.parametrize(("most_gib", "over"), [(0.25, r"array: 0\.\d\d GiB .* 0\.25 .*"), (2.0, "")])
def test_a_work_that_takes_too_much_memory_fails_the_check(most_gib, over):
    ratio = size.memory_ratio("array", partial(np.ones, 2**26), most_gib)
    assert re.fullmatch(over, "".join(checked(SpeedTable((ratio,), (), "abc123", "", {}, {}), {})[1]))


@pytest.mark.long
def test_large_works_are_timed_with_their_peak_of_memory(monkeypatch):
    monkeypatch.setattr(size, "store_thousand", partial(store_wide, methods=("a", "b"), trials=2))
    report, body = size_ratios(Settings())
    assert (report.work, body.work) == (size.REPORT_WORK, "21 M facets, made and rendered, 4096 x 4096")
    assert report.clock == body.clock == "cpu" and "resident memory up to 0." in report.agreement
    assert float(re.search(r"up to ([\d.]+) GiB", body.agreement)[1]) < 4.0
    assert report.over == body.over == ""


def test_a_system_that_does_not_tell_the_peak_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(size, "_STATUS", tmp_path / "status")
    (absent,) = size_ratios(Settings())
    assert "memory" in absent.why

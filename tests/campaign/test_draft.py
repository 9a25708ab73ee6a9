"""What a draft of a campaign leaves out, and what it never does."""

from __future__ import annotations

import pytest
from mission_data import needs_data
from tiny_campaign import Heard

from boresight.campaign.resolved import as_draft, drafted, kept
from boresight.campaign.runs.execute import run_campaign
from boresight.campaign.runs.manifest import RunRequest
from boresight.campaign.runs.resolve import resolve
from boresight.estimators.landmark.database import DatabaseOptions
from boresight.renderers.mitsuba3 import choose_variant
from boresight.reports.run.data import read_run


@pytest.mark.parametrize(
    ("whole", "share", "least", "wanted"),
    [
        (1000, 0.05, 1, 50),
        (20, 0.05, 1, 1),
        (5, 0.05, 1, 1),
        (1, 0.05, 2, 1),
        (5, 0.05, 2, 2),
        (60, 0.05, 2, 3),
        (7, 0.5, 2, 4),
        (7, 1.0, 2, 7),
    ],
)
def test_a_draft_keeps_a_share_and_no_less_than_a_method_needs(whole, share, least, wanted):
    assert kept(whole, share, least) == wanted


@pytest.mark.parametrize(
    ("images", "share", "wanted"), [(500, 0.05, 120), (500, 0.5, 250), (80, 0.05, 80), (500, 1.0, 500)]
)
def test_a_draft_makes_data_bases_of_fewer_images_with_a_floor(images, share, wanted):
    assert drafted(DatabaseOptions(images=images), share).images == wanted


@pytest.mark.parametrize(("share", "wanted"), [(0.05, 6), (0.5, 12), (1.0, 24)])
def test_landmarks_of_a_draft_are_asked_to_be_seen_in_as_large_a_share_of_the_images(share, wanted):
    assert drafted(DatabaseOptions(images=500, min_observations=24), share).min_observations == wanted


@needs_data("shapes/itokawa_gaskell_q64.ply")
@pytest.mark.long
def test_a_data_base_of_a_draft_of_the_paper_has_landmarks(tmp_path):
    variant = choose_variant().name
    run_campaign(as_draft(resolve("rowell2015-simulated", variant=variant), 0.05), RunRequest(tmp_path, 2, 2), Heard())
    (product,) = read_run(tmp_path).manifest.products
    assert product.n_landmarks > 200


def test_a_draft_renders_a_share_of_the_sets_of_images_that_are_pooled():
    whole = resolve("delpech2015-images-textures")
    draft = as_draft(whole, 0.05)
    assert [one.spec.body.detail.seed for one in draft.scenarios] == [11, 12]
    assert list(draft.variations) == [one.spec.name for one in draft.scenarios] == list(whole.variations)[:2]


def test_a_draft_cuts_an_arc_of_rendered_images_at_the_same_time_between_them():
    campaign = resolve("cheng2003-endtoend")
    whole, cut = (one.scenarios[0].spec.orbit for one in (campaign, as_draft(campaign, 0.05)))
    assert (whole.imaging.epochs, cut.imaging.epochs) == (208, 24)
    assert cut.arc.days / 24 == pytest.approx(whole.arc.days / 208)
    assert cut.model_copy(update={"arc": whole.arc, "imaging": whole.imaging}) == whole


@pytest.mark.parametrize("name", ["delpech2015-sensitivity", "endtoend-smoke", "quickstart"])
def test_a_draft_leaves_out_nothing_that_is_compared_or_costs_no_image(name):
    whole = resolve(name)
    draft = as_draft(whole, 0.05)
    assert [one.spec for one in draft.scenarios] == [one.spec for one in whole.scenarios]
    assert draft.labels == whole.labels


def test_a_draft_has_two_worlds_of_five():
    whole = resolve("trade-craters")
    assert (whole.spec.databases, as_draft(whole, 0.05).spec.databases) == (5, 2)
    assert as_draft(whole, 0.6).spec.databases == 3


def test_all_of_it_is_no_draft():
    whole = resolve("quickstart")
    assert as_draft(whole, 1.0) is whole


def test_a_draft_is_another_run_by_its_share_and_by_the_rule(monkeypatch):
    whole = resolve("quickstart")
    told = {as_draft(whole, share).digest for share in (0.05, 0.1, 1.0)}
    monkeypatch.setattr("boresight.campaign.resolved.DRAFT_VERSION", 5)
    assert len(told | {as_draft(whole, 0.05).digest}) == 4
    assert as_draft(whole, 1.0).digest in told

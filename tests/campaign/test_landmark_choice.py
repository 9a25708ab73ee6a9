"""A campaign of the paper's recogniser beside the one that keeps a recognition only where it is the better likeness."""

from tiny_campaign import DATABASE, compute, write_campaign

from boresight.campaign.store import RunFolder

CAMPAIGN = f"""\
scenarios: [scene]
estimators:
  - landmark-harris: {{database: {DATABASE}}}
  - landmark-harris: {{label: careful, database: {DATABASE}, keep: if-better}}
trials: 12
seed: 5
"""


def test_the_choice_is_between_the_stages_of_the_paper_trial_by_trial(cache, tmp_path):
    compute(write_campaign(tmp_path, CAMPAIGN), tmp_path / "run", 12)
    run = RunFolder(tmp_path / "run")
    rows, stages = (run.table(name).set_index(["estimator", "trial"]) for name in ("rows", "stages"))
    kept = run.table("diagnostics").query("name == 'kept'").set_index("trial")["value"] == 1.0
    assert 0 < kept.sum() < len(kept) == 12
    paper, careful = (stages.loc[label].set_index("stage", append=True) for label in ("landmark-harris", "careful"))
    for trial, recognised in kept.items():
        own = rows.loc[("careful", trial)]
        error = paper.loc[(trial, "recognition" if recognised else "centroid"), "position_error_m"]
        assert own["position_error_m"] == error == careful.loc[(trial, "choice"), "position_error_m"]
        assert own["n_landmarks"] == (rows.loc[("landmark-harris", trial), "n_landmarks"] if recognised else 0)
        assert (own["status"], own["nees"] is None or own["nees"] != own["nees"]) == ("ok", not recognised)

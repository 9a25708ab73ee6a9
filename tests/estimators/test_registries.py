"""Methods by name, of all contracts: the built-in ones, and those of third parties by their entry points."""

from __future__ import annotations

import pytest
from third_party import install

from boresight.estimators import registry
from boresight.estimators.registry import DETECTORS, MATCHERS
from boresight.estimators.registry import SEQUENCE_ESTIMATORS as SEQUENCES
from boresight.scenarios.errors import BoresightError

# The registry, a name of ours, a name that is nearly one of ours, and what the contract wants besides name and version.
CONTRACTS = {
    "estimators": (registry.ESTIMATORS, "prior", "landmark-surf", "landmark-sift", "estimate"),
    "sequence_estimators": (SEQUENCES, "dead-reckoning", "dead-reckonin", "dead-reckoning", "follow"),
    "crater_detectors": (DETECTORS, "crater-classic", "crater-clasic", "crater-classic", "detect"),
    "crater_matchers": (MATCHERS, "vote", "votes", "vote", "match"),
}
GOOD = """
class Other:
    name, version = "other", 4
    @classmethod
    def from_options(cls, options, assets=None):
        return cls()
    def {method}(self, *arguments, **keywords):
        raise NotImplementedError
"""


@pytest.mark.parametrize("group", CONTRACTS)
def test_a_third_partys_method_is_found_and_a_name_of_ours_stays_ours(tmp_path, monkeypatch, group):
    found, own, *_, method = CONTRACTS[group]
    assert found.group == f"boresight.{group}"
    before = found.find(own)
    install(tmp_path, group, "other", GOOD.format(method=method), {"other": "Other", own: "Other"}, monkeypatch)
    assert "other" in found.names()
    assert found.find("other").version == 4
    assert found.find(own) is before
    assert before.__module__.startswith("boresight.")


@pytest.mark.parametrize("group", CONTRACTS)
@pytest.mark.parametrize(
    ("code", "target", "said"),
    [
        ("import not_there", "Other", "cannot be imported from other:Other: No module named 'not_there'"),
        (GOOD, "Missing", "cannot be imported from other:Missing"),
        ("", "Other", "cannot be imported from other:Other"),
        ("1 / 0", "Other", "cannot be imported from other:Other: division by zero"),
        ("class Other: name, version = 'other', 1", "Other", r"'other' \(other:Other\) lacks from_options, {method}"),
        ("class Other: name = 'other'", "Other", "lacks version, from_options, {method}"),
    ],
)
def test_what_does_not_follow_the_contract_is_named_in_one_line(tmp_path, monkeypatch, group, code, target, said):
    found, *_, method = CONTRACTS[group]
    install(tmp_path, group, "other", code.format(method=method), {"other": target}, monkeypatch)
    assert "other" in found.names()
    with pytest.raises(BoresightError, match=said.format(method=method)) as caught:
        found.find("other")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("group", CONTRACTS)
def test_an_unknown_name_is_told_what_there_is(group):
    found, _, wrong, near, _ = CONTRACTS[group]
    with pytest.raises(BoresightError, match=f"'{wrong}' is unknown; did you mean {near}"):
        found.find(wrong)


def test_a_detector_by_a_file_leaves_the_versions_of_databases_and_chains_as_they_are():
    named = ("crater-classic", "crater-heat-map", "crater-learned")
    assert registry.named_detector_versions() == [DETECTORS.find(name).version for name in named]


@pytest.mark.parametrize("name", DETECTORS.names())
def test_each_detector_is_its_class_and_refuses_an_unknown_option(name):
    found = DETECTORS.find(name)
    assert found.name == name
    with pytest.raises(
        BoresightError, match=rf"estimator {name}: no_such_thing: unknown key; known here are .*(window_px|model)"
    ):
        found.from_options({"no_such_thing": 1})

"""What a worker process does with one block of trials."""

from __future__ import annotations

from functools import lru_cache

from campaign.experiments.registry import Bench, Experiment, Records, experiment_class
from campaign.machine import use_threads
from campaign.resolve import ResolvedCampaign
from campaign.store import TABLES
from campaign.store.folder import Block


def run_block(campaign: ResolvedCampaign, block: Block, bench: Bench) -> Records:
    """Run every trial of a block: the records of each table, in the order of trials and estimators."""
    use_threads(bench.jobs)
    found = experiment_of(campaign, block.scenario, bench).run(range(block.first, block.last))
    return {name: found.get(name, []) for name in TABLES}


@lru_cache(maxsize=1)
def experiment_of(campaign: ResolvedCampaign, scenario_name: str, bench: Bench) -> Experiment:
    """Build the experiment once per process and scenario."""
    return experiment_class(campaign.spec.experiment).open(campaign, campaign.scenario(scenario_name), bench)

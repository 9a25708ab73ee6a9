"""Load scenario and campaign files: read, extend, override, validate.

Precedence: defaults < ``extends`` < file < a campaign's ``set`` < ``--set``. Every error is one line with its location.
"""

from boresight.scenarios.load.files import (
    LoadedCampaign,
    LoadedScenario,
    file_kind,
    load_campaign,
    load_scenario,
    names_in,
    scenario_names,
)
from boresight.scenarios.load.keys import json_schema
from boresight.scenarios.load.merge import parse_override
from boresight.scenarios.load.yaml_text import ConfigEntry, dump_yaml
from boresight.scenarios.spec.base import canonical_json, digest

__all__ = [
    "ConfigEntry",
    "LoadedCampaign",
    "LoadedScenario",
    "canonical_json",
    "digest",
    "dump_yaml",
    "file_kind",
    "json_schema",
    "load_campaign",
    "load_scenario",
    "names_in",
    "parse_override",
    "scenario_names",
]

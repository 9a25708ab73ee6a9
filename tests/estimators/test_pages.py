"""The page of every registered estimator is complete."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec

import pytest

from boresight.estimators.options import OptionsError
from boresight.estimators.pages import FAMILIES, SECTIONS, page_of
from boresight.estimators.registry import EXTRAS
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load.keys import keys_of
from boresight.scenarios.spec.base import SpecModel

NAMES = [name for registry in FAMILIES.values() for name in registry.own]


def unexplained(model: type[SpecModel], path: str) -> Iterator[str]:
    for key in keys_of(model):
        if not key.meaning or not key.type:
            yield f"{path}.{key.name}"
        for section in key.sections:
            yield from unexplained(section, f"{path}.{key.name}")


def test_names_of_all_families_differ():
    assert len(NAMES) == len(set(NAMES)) == 39


@pytest.mark.parametrize("name", NAMES)
def test_every_estimator_has_all_sections_and_explains_its_options(name):
    page = page_of(name)
    assert page.name == name
    assert page.family in FAMILIES
    assert page.summary and "\n" not in page.summary
    assert tuple(page.sections) == SECTIONS
    assert [heading for heading, text in page.sections.items() if not text.endswith(".")] == []
    assert page.options
    assert [key for model in page.options for key in unexplained(model, name)] == []


@pytest.mark.parametrize("name", NAMES)
def test_the_options_of_the_page_are_those_that_the_estimator_reads(name):
    if name in EXTRAS and find_spec(EXTRAS[name]) is None:
        pytest.skip(f"needs the extra {EXTRAS[name]}")
    found = FAMILIES[page_of(name).family].find(name)
    assets = (None,) if "assets" in found.from_options.__annotations__ else ()
    with pytest.raises(OptionsError, match="no_such_option") as raised:
        found.from_options({"no_such_option": 1}, *assets)
    # What a trial tells any matcher of craters follows the matcher's own.
    assert raised.value.model is page_of(name).options[0]


def test_a_foreign_class_needs_no_sections(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "class Mine:\n"
        '    """Guesses.\n\n    At random.\n\n    Cost\n    ----\n    1 us.\n    """\n'
        '    name, version = "mine", 3\n'
        "    @classmethod\n    def from_options(cls, options, assets): return cls()\n"
        "    def estimate(self, observation, *, rng): ...\n"
    )
    page = page_of(f"{file}:Mine")
    assert (page.name, page.version, page.summary, page.text) == ("mine", 3, "Guesses.", "At random.")
    assert (dict(page.sections), page.options) == ({"Cost": "1 us."}, ())


def test_an_unknown_name_is_refused_in_one_line():
    with pytest.raises(BoresightError, match="did you mean landmark-ransac"):
        page_of("landmark-ransack")

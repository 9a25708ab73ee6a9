"""Every key of the scenario schema changes the result: a dispersion that is never applied is the classic silent fault.

One key at a time is overridden as on the command line, in a scenario where it applies, and the fingerprint of what
an estimator sees (image, prior pose, its covariance, the Sun) and of the truth must change.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Annotated, Union, get_args, get_origin

import pytest
from every_key.changes import CHANGES, NO_RESULT, SAME_TERMS
from every_key.files import write_files
from every_key.fingerprints import fingerprint
from every_key.scenes import RENDERED

from boresight.scenarios.spec.base import SpecModel
from boresight.scenarios.spec.distribution import Law, Law3
from boresight.scenarios.spec.scenario import ScenarioSpec


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys")
    write_files(folder)
    return folder


def leaves(model: type[SpecModel], prefix: str = "") -> Iterator[str]:
    """Yield the dotted name of every key of the schema that holds a value.

    What is known on board is said in the terms of the body and its reflectance, whose keys have their own lines.
    """
    for name, field in model.model_fields.items():
        models = [] if prefix + name in SAME_TERMS else list(_models(field.annotation))
        if not models:
            yield prefix + name
        for inner in models:
            yield from leaves(inner, f"{prefix}{name}.")


def _models(annotation: object) -> Iterator[type[SpecModel]]:
    if isinstance(annotation, type) and issubclass(annotation, Law | Law3):
        return  # a value; tests/scenarios/test_draw.py has the laws
    if isinstance(annotation, type) and issubclass(annotation, SpecModel):
        yield annotation
    elif get_origin(annotation) in (Union, UnionType, Annotated):
        for argument in get_args(annotation):
            yield from _models(argument)


_BASELINES: dict[str, str] = {}


def test_every_key_of_the_schema_is_here():
    found = set(leaves(ScenarioSpec))
    listed = set(CHANGES) | set(NO_RESULT)
    assert found == listed, f"not tested: {sorted(found - listed)}; no such key: {sorted(listed - found)}"


@pytest.mark.parametrize("key", CHANGES)
def test_changing_the_key_alone_changes_the_result(key: str, place: Path):
    text, value = CHANGES[key]
    file = place / f"base-{hashlib.sha256(text.encode()).hexdigest()[:8]}.yaml"
    file.write_text(text)
    if text not in _BASELINES:
        _BASELINES[text] = fingerprint(file)
    assert fingerprint(file, (f"{key}={value}",)) != _BASELINES[text]


def test_the_fingerprint_itself_stands_still(place: Path):
    file = place / "still.yaml"
    file.write_text(RENDERED)
    assert fingerprint(file) == fingerprint(file)

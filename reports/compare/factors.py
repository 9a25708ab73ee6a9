"""What tells the subjects of a comparison apart, and which trials of two of them are the same.

Two trials are the same where chance decided the same: by the same seed, the same number of the trial and scenarios
that agree in all from which views, priors and tracks are drawn. What else differs (a reflectance, a detector, what is
known on board) is what is compared.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from reports.run.data import RunData
from scenarios.errors import BoresightError

ESTIMATOR, SCENARIO, RUN = "estimator", "scenario", "run"
NAME_FACTORS = (ESTIMATOR, SCENARIO, RUN)
_NAMES = ("name", "description")
_DRAWN = ("viewpoint", "lighting", "pose_error", "images", "sequence")
_MISSING = object()


def check_factors(factors: Sequence[str], runs: Sequence[RunData]) -> None:
    """Refuse factors that are neither names nor keys of every scenario.

    Raises
    ------
    BoresightError
        The first such factor, and what there is in its place.
    """
    for factor in factors:
        if factor in NAME_FACTORS:
            continue
        for run in runs:
            for name, spec in run.manifest.scenarios.items():
                if value_at(spec, factor) is _MISSING:
                    sections = ", ".join(key for key in spec if key not in _NAMES)
                    raise BoresightError(
                        f"--by {factor}: the scenario {name} of {run.folder} has no such key: give {', '.join(NAME_FACTORS)}"
                        f" or a key of the scenarios ({sections})"
                    )


def value_at(spec: Mapping[str, Any], key: str) -> object:
    """Look a dotted key up; `_MISSING` where there is none."""
    value: object = spec
    for part in key.split("."):
        if not isinstance(value, Mapping) or part not in value:
            return _MISSING
        value = value[part]
    return value


def level_text(spec: Mapping[str, Any], factor: str) -> str:
    """Print a scenario's value of a key: a section by its kind, and by what is set in it beside."""
    value = value_at(spec, factor)
    if not isinstance(value, Mapping):
        return str(value)
    rest = [f"{name} {part}" for name, part in value.items() if name != "kind" and part is not None]
    return " ".join(filter(None, (str(value.get("kind", "")), ", ".join(rest))))


def short_levels(levels: Sequence[str]) -> dict[str, str]:
    """Shorten values of sections to their kinds where these alone tell them apart."""
    kinds = {one: one.split(" ", 1)[0] for one in levels}
    return kinds if len(set(kinds.values())) == len(kinds) else {one: one for one in levels}


def remainder(spec: Mapping[str, Any], factors: Sequence[str]) -> str:
    """Write all of a scenario that no factor tells apart; '' where its name is a factor."""
    if SCENARIO in factors:
        return ""
    left = {key: value for key, value in spec.items() if key not in _NAMES}
    for factor in (factor for factor in factors if factor not in NAME_FACTORS):
        left = _without(left, factor.split("."))
    return _json(left)


def _without(spec: Mapping[str, Any], path: Sequence[str]) -> dict[str, Any]:
    first, *further = path
    left = dict(spec)
    inner = left.pop(first)
    return {**left, first: _without(inner, further)} if further else left


def drawn_settings(spec: Mapping[str, Any]) -> str:
    """Write all of a scenario that what chance decides in its trials depends on.

    The camera is part of it where views or priors are drawn in its pixels, the body where landmarks or views are.
    """
    viewpoint, pose_error = (spec.get(name) or {} for name in ("viewpoint", "pose_error"))
    sequence = spec.get("sequence") or {}
    in_sight = viewpoint.get("keep_clear_px") is not None
    in_pixels = in_sight or pose_error.get("position_cam_px") is not None or bool(sequence)
    on_body = in_sight or (bool(sequence) and sequence.get("sphere_radius_m") is None)
    names = (*_DRAWN, *(["camera"] if in_pixels else []), *(["body"] if on_body else []))
    return _json({name: spec.get(name) for name in names})


def first_difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """Say in which key the draws of two scenarios differ first; '' where in none."""
    pair = (json.loads(drawn_settings(one)), json.loads(drawn_settings(other)))
    return next(_differences(*pair), "")


def _differences(one: object, other: object, path: str = "") -> Iterator[str]:
    if isinstance(one, dict) and isinstance(other, dict):
        for key in dict.fromkeys([*one, *other]):
            yield from _differences(one.get(key), other.get(key), f"{path}.{key}" if path else key)
    elif one != other:
        yield f"{path} is {_json(one)} and {_json(other)}"


def _json(value: object) -> str:
    return json.dumps(value, sort_keys=True)

"""Estimators of other packages, by their entry points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any

from scenarios.errors import BoresightError


def names_with(own: Mapping[str, str], group: str) -> tuple[str, ...]:
    """Return our own names and those of third parties in an entry-point group, sorted."""
    return tuple(sorted({*own, *(point.name for point in entry_points(group=group))}))


def load_by_name(name: str, own: Mapping[str, str], group: str, parts: Sequence[str]) -> Any:
    """Import what a name stands for; our own names cannot be taken over by a third party.

    Parameters
    ----------
    name
        The name.
    own
        Name to "module:attribute" of ours.
    group
        Entry-point group of the others.
    parts
        Attributes that the contract asks of a class.

    Raises
    ------
    BoresightError
        If there is none of that name, or a third party's cannot be imported or lacks a part.
    """
    if name in own:
        module, attribute = own[name].split(":")
        return getattr(import_module(module), attribute)
    points = [point for point in entry_points(group=group) if point.name == name]
    if not points:
        raise BoresightError(f"estimator {name!r} is unknown; there are: {', '.join(names_with(own, group))}")
    try:
        found = points[0].load()
    except (ImportError, AttributeError) as error:
        raise BoresightError(f"estimator {name!r} cannot be imported from {points[0].value}: {error}") from error
    missing = [part for part in parts if not hasattr(found, part)]
    if missing:
        raise BoresightError(f"estimator {name!r} ({points[0].value}) lacks {', '.join(missing)} of the contract")
    return found

"""Estimators by name: tables of our own, and those of other packages by their entry points."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import entry_points
from typing import Generic, TypeVar, cast

from scenarios.errors import BoresightError, one_line

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Registry(Generic[T]):
    """Classes that keep one contract, by name.

    Parameters
    ----------
    own
        Name to "module:attribute" of ours.
    group
        Entry-point group of the others.
    parts
        Attributes that the contract asks of a class.
    """

    own: Mapping[str, str]
    group: str
    parts: tuple[str, ...]

    def names(self) -> tuple[str, ...]:
        """All names, sorted; third-party ones included."""
        return tuple(sorted({*self.own, *(point.name for point in entry_points(group=self.group))}))

    def find(self, name: str) -> type[T]:
        """Import what a name stands for; our own names cannot be taken over by a third party.

        Raises
        ------
        BoresightError
            If there is none of that name, or a third party's cannot be imported or lacks a part.
        """
        if name in self.own:
            module, attribute = self.own[name].split(":")
            return cast("type[T]", getattr(import_module(module), attribute))
        points = [point for point in entry_points(group=self.group) if point.name == name]
        if not points:
            raise BoresightError(f"estimator {name!r} is unknown; there are: {', '.join(self.names())}")
        try:
            found = points[0].load()
        except Exception as error:  # a module of others may raise anything
            said = one_line(error) or type(error).__name__
            raise BoresightError(f"estimator {name!r} cannot be imported from {points[0].value}: {said}") from error
        missing = [part for part in self.parts if not hasattr(found, part)]
        if missing:
            raise BoresightError(f"estimator {name!r} ({points[0].value}) lacks {', '.join(missing)} of the contract")
        return cast("type[T]", found)

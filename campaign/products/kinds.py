"""Kinds of product by name. A kind is a module in this folder with the functions of `ProductKind`, and a line below."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

from campaign.products import crater_database, descriptors, landmark_database, maplets
from scenarios.errors import BoresightError
from scenarios.load import LoadedScenario
from scenarios.spec.base import SpecModel


class ProductKind(Protocol):
    """What a module of this folder offers.

    A product is built once from what the spacecraft believes of a scenario, stored in a folder, kept by the hash of
    everything that it depends on, and lent to estimators.
    """

    def parse(self, options: Mapping[str, object]) -> SpecModel:
        """Validate the options that an estimator asks with."""
        ...

    def versions(self) -> list[int]:
        """List the versions of all code that the product depends on, beside the renderer's."""
        ...

    def announcement(self, options: SpecModel) -> str:
        """Say what takes time in a build."""
        ...

    def build(
        self, scenario: LoadedScenario, options: SpecModel, folder: Path, jobs: int, variant: str
    ) -> Mapping[str, object] | None:
        """Build the product into an empty folder; return what is to be said of the building, if anything."""
        ...

    def load(self, folder: Path) -> object:
        """Read it back."""
        ...

    def about(self, folder: Path) -> dict[str, object]:
        """Describe it for the manifest, in plain values."""
        ...


_KINDS: Mapping[str, ProductKind] = MappingProxyType(
    {module.KIND: module for module in (landmark_database, maplets, descriptors, crater_database)}
)


def product_kind(name: str) -> ProductKind:
    """Look up a kind.

    Raises
    ------
    BoresightError
        If there is none of that name.
    """
    if name not in _KINDS:
        raise BoresightError(f"no product is called {name!r}; there are: {', '.join(sorted(_KINDS))}")
    return _KINDS[name]

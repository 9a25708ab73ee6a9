"""Validate the options of an estimator given in a campaign."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from pydantic import ValidationError

from scenarios.errors import BoresightError, printable
from scenarios.load.merge import on_defaults
from scenarios.spec.base import SpecModel

Model = TypeVar("Model", bound=SpecModel)


def parse_options(model: type[Model], options: Mapping[str, object], estimator: str) -> Model:
    """Validate ``options`` by ``model``; options left out keep their default.

    Raises
    ------
    BoresightError
        With one line for each wrong option: estimator, dotted key, value and what is allowed.
    """
    try:
        return model.model_validate(on_defaults((model,), options))
    except ValidationError as error:
        lines = [
            printable(
                f"estimator {estimator}: {'.'.join(str(part) for part in item['loc']) or 'options'}:"
                f" {item['msg']} (got {item['input']!r})"
            )
            for item in error.errors(include_url=False)
        ]
        raise BoresightError("\n".join(lines)) from error

"""Validate the options of an estimator given in a campaign."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Generic, Self, TypeVar, cast

from pydantic import ValidationError

from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load.explain import explain
from boresight.scenarios.load.merge import on_defaults
from boresight.scenarios.load.yaml_text import ConfigEntry, entry_of
from boresight.scenarios.spec.base import SpecModel

Model = TypeVar("Model", bound=SpecModel)


class OptionsError(BoresightError):
    """Wrong options of an estimator; they are of ``model``, in nested ``sections`` of its options."""

    model: type[SpecModel] = SpecModel
    sections: tuple[str, ...] = ()

    def located(self, options: ConfigEntry, estimator: str) -> BoresightError:
        """Return the error with the file and line of each wrong option."""
        if not isinstance(self.__cause__, ValidationError):
            return self
        for section in self.sections:
            options = (options.section or {}).get(section, options)
        return BoresightError(explain(self.__cause__, options, self.model, ".".join((estimator, *self.sections))))


def parse_options(model: type[Model], options: Mapping[str, object], estimator: str) -> Model:
    """Validate ``options`` by ``model``; options left out keep their default.

    Raise `OptionsError` with one line for each wrong option: estimator, dotted key, value and what is allowed.
    """
    try:
        return model.model_validate(on_defaults((model,), options))
    except ValidationError as fault:
        error = OptionsError(explain(fault, entry_of(options, f"estimator {estimator}"), model))
        error.model = model
        raise error from fault


def surveyed(options: Mapping[str, object]) -> bool:
    """Say whether an estimator, or one that it builds on, has a data base made from the images of a survey."""
    sections = [value for value in options.values() if isinstance(value, Mapping)]
    return options.get("source") == "survey" or any(map(surveyed, sections))


class Configured(Generic[Model]):
    """Base of methods with options alone, by default those of the model; a subclass names itself and that model."""

    name: ClassVar[str]
    version: ClassVar[int]
    options_model: ClassVar[type[SpecModel]]

    def __init__(self, options: Model | None = None) -> None:
        self.options = cast("Model", self.options_model()) if options is None else options

    @classmethod
    def from_options(cls, options: Mapping[str, object]) -> Self:
        """Build from a campaign's options; raise BoresightError on a wrong one."""
        return cls(cast("Model", parse_options(cls.options_model, options, cls.name)))


def model_of(method: type) -> type[SpecModel] | None:
    """Return the model of a method's options; None if its class has none, or something else of that name."""
    model = getattr(method, "options_model", None)
    return model if isinstance(model, type) and issubclass(model, SpecModel) else None

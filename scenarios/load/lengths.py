"""Fill in lengths and numbers that are left out, from the scale of a scenario."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import ValidationError

from boresight.scenarios.arrays import FloatArray
from boresight.scenarios.errors import BoresightError
from boresight.scenarios.load.merge import Models, Plain, field_models, meant_model
from boresight.scenarios.spec.base import SpecModel, rule_of
from boresight.scenarios.spec.body import ADDED_TO_SHAPE, BodySpec, without_detail
from boresight.scenarios.spec.camera import CameraSpec
from boresight.scenarios.spec.craters import CraterPairsSpec, CratersSpec

Model = TypeVar("Model", bound=SpecModel)
Sides = tuple[float, float, float]

_THOMSEN = 1.6075


@dataclass(frozen=True, slots=True)
class Scale:
    """Pixel, body and frame of a scenario, by which values are measured.

    ``m_per_px`` and ``sides_m``, called when a value needs them, return the length across the line of sight that a
    pixel covers at the median range, and the sides of the body's box, m. ``frame_px2`` is the area of an image, px^2.
    """

    m_per_px: Callable[[], float | None]
    sides_m: Callable[[], Sides | None]
    frame_px2: float | None = None

    def value(self, rule: dict[str, float], default: object) -> float | int | None:
        """Return the value of a rule; None if it is not known, or if it is a number that stays at its default."""
        if "each_px2" not in rule:
            return self.length_m(rule)
        times = max(1, round((self._body_px2() or 0.0) / rule["each_px2"]))
        return min(times * default, int(rule["most"])) if isinstance(default, int) and times > 1 else None

    def _body_px2(self) -> float | None:
        """Return the area of the body in the image, averaged over all directions, px^2; at most that of the image."""
        sides_m, m_per_px = self.sides_m(), self.m_per_px()
        if sides_m is None or m_per_px is None or self.frame_px2 is None:
            return None
        # A convex body's silhouette is a quarter of its surface on average (Cauchy). Of the ellipsoid in the box, as
        # facets of a rough shape have a larger surface: Thomsen's formula, good to 1.1 %.
        a, b, c = ((0.5 * side_m) ** _THOMSEN for side_m in sides_m)
        area_m2 = float(np.pi * ((a * b + a * c + b * c) / 3.0) ** (1.0 / _THOMSEN))
        return min(area_m2 / m_per_px**2, self.frame_px2)

    def length_m(self, rule: dict[str, float]) -> float | None:
        """Return the length of a rule, m; None if it is not known.

        Four digits are kept, so that a number can be read, and does not depend on the machine.
        """
        ones_m = {unit: self.m_per_px() if unit == "px" else max(self.sides_m() or (), default=None) for unit in rule}
        known_m = [rule[unit] * one_m for unit, one_m in ones_m.items() if one_m is not None]
        return float(f"{min(known_m):.4g}") if known_m else None


def lengths_left_out(models: Models, given: Mapping[str, Any], scale: Scale, default: SpecModel | None = None) -> Plain:
    """Return the lengths and numbers that a plain mapping leaves out, in its own form: sections within sections.

    The ``kind`` or the keys of the mapping select one of the models. ``default`` is the section where nothing is given,
    if its keys differ from the defaults of its model.
    """
    model = meant_model(models, given)
    found: Plain = {}
    for key, field in ({} if model is None else model.model_fields).items():
        value, usual = given.get(key), getattr(default, key, field.default)
        section = usual if isinstance(usual, SpecModel) else None
        if value is None and (rule := rule_of(field)) is not None:
            found[key] = scale.value(rule, usual)
        elif isinstance(value, Mapping):
            found[key] = lengths_left_out(field_models(models, key), value, scale, section)
        elif key not in given and section is not None:
            found[key] = lengths_left_out((type(section),), {}, scale, section)
    return {key: value for key, value in found.items() if value is not None and value != {}}


def with_lengths(given: Mapping[str, Any], lengths: Mapping[str, Any]) -> Plain:
    """Return values with lengths put into their sections."""
    sections = {key: value for key, value in lengths.items() if isinstance(value, Mapping)}
    return {**given, **lengths, **{key: with_lengths(given.get(key) or {}, value) for key, value in sections.items()}}


def dotted(lengths: Mapping[str, Any], where: str = "") -> Iterator[tuple[str, float]]:
    """Yield each value with its key, dotted."""
    for key, value in lengths.items():
        if isinstance(value, Mapping):
            yield from dotted(value, f"{where}{key}.")
        else:
            yield f"{where}{key}", value


def scale_as_written(plain: Plain, folders: Sequence[Path], embedded: bool) -> Scale:
    """Return the scale of a scenario from its keys, before they are checked; unknown where one of them is wrong."""
    part = partial(_part, folders)

    def m_per_px() -> float | None:
        try:
            pairs = part(CraterPairsSpec, plain.get("crater_pairs"))  # the only ones with a length in pixels
            return pairs.range_m / part(CameraSpec, plain.get("camera")).camera().fx_px
        except (ValidationError, BoresightError):
            return None

    def sides_m() -> Sides | None:
        given = plain.get("body") or {}
        try:
            body = part(BodySpec, {key: given[key] for key in given if key not in ADDED_TO_SHAPE})
        except (ValidationError, TypeError):
            return None
        return body_sides_m(body.embedded() if embedded else body, folders)

    return Scale(m_per_px, sides_m)  # no key of a scenario is a number that follows from the image


def _part(folders: Sequence[Path], model: type[Model], value: object) -> Model:
    return model.model_validate(value, context={"folders": folders})


def surface_m(plain: Plain, folders: Sequence[Path], embedded: bool, direction: FloatArray) -> float:
    """Return the distance of a scenario's true surface from the origin along a unit vector, (3,), m, by its keys.

    Raise BoresightError if it cannot be read, or its keys are wrong, which the check of its section says too.
    """
    # Imported here: most scenarios are read without their shape, and data sets of shapes are read by this package.
    from boresight.scenarios.bodies import load_body
    from boresight.scenarios.craters import cratered_surface

    sequence = plain.get("sequence")
    sphere_m = sequence.get("sphere_radius_m") if isinstance(sequence, Mapping) else None
    if isinstance(sphere_m, int | float):
        return float(sphere_m)
    try:
        body = _part(folders, BodySpec, plain.get("body") or {})
        craters = None if plain.get("craters") is None else _part(folders, CratersSpec, plain["craters"])
    except ValidationError:
        raise BoresightError("the surface below it is not known, as body or craters are wrong") from None
    body = body.embedded() if embedded else body
    if craters is not None:
        _ = craters.listed_from_m  # refused where it is missing, before the surface is made
        return cratered_surface(body, craters, folders).distance_along_m(direction)
    return load_body(body, folders).mesh.distance_along_m(direction)


def body_sides_m(body: BodySpec, search_dirs: Sequence[Path]) -> Sides | None:
    """Return the sides of the box of a shape without its detail, m; None if it cannot be read."""
    # Imported here: most scenarios are read without their shape, and data sets of shapes are read by this package.
    from boresight.scenarios.bodies import body_digest

    coarse = without_detail(body)
    try:
        return _measured_m(coarse, tuple(search_dirs), body_digest(coarse, search_dirs))
    except BoresightError:
        return None  # `validate` and a run say what is wrong with the shape


@lru_cache(maxsize=8)
def _measured_m(coarse: BodySpec, search_dirs: tuple[Path, ...], _digest: str) -> Sides:
    from boresight.scenarios.bodies import load_body

    x_m, y_m, z_m = np.ptp(load_body(coarse, search_dirs).mesh.vertices_m, axis=0).tolist()
    return x_m, y_m, z_m

"""Mitsuba's variants, where they work."""

from __future__ import annotations

import pytest

from boresight.renderers.mitsuba3 import Variant, choose_variant
from boresight.scenarios.errors import BoresightError


def variant_or_skip(name: str) -> Variant:
    """Choose a variant; the test is skipped and says why where it does not work."""
    try:
        return choose_variant(name)
    except BoresightError as error:
        pytest.skip(str(error))

"""Pages without pictures, for tests that read their texts: drawing takes most of a page's time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from boresight.reports.figures import style


@contextmanager
def undrawn(*kinds: str) -> Iterator[None]:
    """Write an empty file for each figure that is to be of one of these kinds (``png``, ``pdf``)."""
    really = style.render
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "render", lambda figure, kind: b"" if kind in kinds else really(figure, kind))
        yield

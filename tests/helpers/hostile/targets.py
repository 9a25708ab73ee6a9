"""All readers by name."""

from __future__ import annotations

from hostile import asked, databases, images, run_folders, runs, shapes
from hostile.target import Target

TARGETS: dict[str, Target] = {
    **asked.targets(),
    **shapes.targets(),
    **images.targets(),
    **databases.targets(),
    **runs.targets(),
    **run_folders.targets(),
}

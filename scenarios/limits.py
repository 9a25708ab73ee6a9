"""What no sound file exceeds, and no machine holds: checked before numbers overflow and before memory is taken."""

import os

LARGEST_NUMBER = 1e30
"""A length of so many metres is beyond the universe; the squares and cubes of such numbers are finite."""
MOST_PIXELS = 1 << 26
"""Of an image: 8192 x 8192, the largest camera of a scenario."""

_MOST_BYTES = 1 << 28
MOST_FOLD = 64
"""So many bytes come out of one of a packed file."""


def may_unfold(stored_bytes: int, unfolded_bytes: int) -> bool:
    """Tell whether so many bytes may come out of a file of so many: a small one that gives very many is a bomb."""
    return unfolded_bytes <= max(_MOST_BYTES, MOST_FOLD * stored_bytes)


def installed_memory_bytes() -> int:
    """Return the memory of this machine."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")

"""Limits of valid input files, checked before numbers overflow and before memory is allocated."""

import os

LARGEST_NUMBER = 1e30
"""Largest accepted magnitude of a number in a file; squares and cubes of it are still finite."""
MOST_PIXELS = 1 << 26
"""Largest image: 8192 x 8192, the largest camera of a scenario."""

_MOST_BYTES = 1 << 28
MOST_FOLD = 64
"""Largest accepted ratio of the uncompressed to the compressed size of a file."""


def may_unfold(stored_bytes: int, unfolded_bytes: int) -> bool:
    """Return whether the uncompressed size is plausible for the stored size (decompression bombs are not)."""
    return unfolded_bytes <= max(_MOST_BYTES, MOST_FOLD * stored_bytes)


def installed_memory_bytes() -> int:
    """Return the installed memory of this machine."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")

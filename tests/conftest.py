"""Kernels are compiled once for all tests: each cache of its own would compile them again, which takes a minute."""

from __future__ import annotations

import os

from scenarios.cache import default_cache

os.environ.setdefault("NUMBA_CACHE_DIR", str(default_cache().root / "kernels"))

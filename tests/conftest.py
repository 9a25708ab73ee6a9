"""Kernels are compiled once for all tests: those with caches of their own would compile them again, for a minute each."""

from __future__ import annotations

import os

from scenarios.cache import default_cache

os.environ.setdefault("NUMBA_CACHE_DIR", str(default_cache().root / "kernels"))

"""Packages of third parties, as pip would leave them in a folder."""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

# A method for each of the module's ANSWERS, of its class Method.
_BASE = """
class Base:
    version = 1
    @classmethod
    def from_options(cls, options, assets=None):
        return cls()
"""
_METHODS = """
for _name in ANSWERS:
    globals()["made_" + _name.replace("-", "_")] = type(_name, (Method,), {"name": _name})
"""


def install(
    folder: Path, group: str, module: str, text: str, names: Mapping[str, str], patch: pytest.MonkeyPatch | None = None
) -> None:
    """Write a package of one module with entry points, attributes by name, where this process finds it if patched."""
    info = folder / f"{module}-1.0.dist-info"
    info.mkdir(parents=True)
    (folder / f"{module}.py").write_text(text, encoding="utf-8")
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {module}\nVersion: 1.0\n")
    lines = [
        f"{name} = {attribute if ':' in attribute else f'{module}:{attribute}'}" for name, attribute in names.items()
    ]
    (info / "entry_points.txt").write_text("\n".join([f"[boresight.{group}]", *lines]) + "\n")
    if patch is not None:
        patch.syspath_prepend(str(folder))
        patch.delitem(sys.modules, module, raising=False)


def install_answers(folder: Path, group: str, text: str, patch: pytest.MonkeyPatch | None = None) -> list[str]:
    """Install a method for each of the ``ANSWERS`` in a text, of its class ``Method(Base)``; return their names."""
    names = re.findall(r'^    "([\w-]+)": ', text, flags=re.MULTILINE)
    made = {name: f"made_{name.replace('-', '_')}" for name in names}
    # A name of its own: a module that another file of tests has imported would be taken in its place.
    module = f"methods_{hashlib.sha256(text.encode()).hexdigest()[:12]}"
    install(folder, group, module, _BASE + text + _METHODS, made, patch)
    return names

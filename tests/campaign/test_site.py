"""The blocks of the documentation's pages run; those of the tutorials, which are notebooks, run when it is built."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import jsonschema
import pytest
from page_blocks import Block, ReachedError, blocks_of, install_entry_points, python_path, run_command, stop_before_long
from ruamel.yaml import YAML

import boresight
from boresight.scenarios.load import json_schema
from boresight.scenarios.spec.campaign import CampaignSpec
from boresight.scenarios.spec.scenario import ScenarioSpec

pytestmark = pytest.mark.long
ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
WRITTEN_AT_BUILD = ("estimators", "reference", "tutorials")
"""Folders of pages that follow from the code, and of notebooks."""

NOT_RUN = ("python3 -m venv", "pip install", "python -m pip install", "dask ", "cd ", "export ", "PYTHONPATH=tests ")
"""Commands of other programs, which would change the machine."""

NOT_INSTALLED = ("dask_jobqueue", "dask_kubernetes")

PAGES = sorted(
    path.relative_to(DOCS).as_posix()
    for path in DOCS.rglob("*.md")
    if path.relative_to(DOCS).parts[0] not in WRITTEN_AT_BUILD and blocks_of(path.read_text(encoding="utf-8"))
)


@pytest.fixture
def folder(examples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder of the page's own, with the files of the examples and links to their runs."""
    for path in examples.iterdir():
        if path.is_file():
            shutil.copy(path, tmp_path)
    shutil.copytree(examples / "runs", tmp_path / "runs")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("page", PAGES)
def test_every_block_of_a_page_runs(page, folder, monkeypatch, capsys):
    written: set[str] = set()
    names: dict[str, object] = {"__name__": "__main__", "boresight": boresight}
    for block in blocks_of((DOCS / page).read_text(encoding="utf-8")):
        if block.file:
            block.write(folder)
            written.add(block.file)
        if block.language == "toml":
            install_entry_points(folder, block.body)
        elif block.language in ("bash", "console"):
            for line in command_lines(block):
                run_line(line, folder, written, monkeypatch, capsys)
        elif block.language == "yaml":
            check_yaml(block)
        elif block.language == "python" and not block.file:
            run_python(block, names, monkeypatch)
        elif block.language == "python":
            compile(block.body, block.file, "exec")
        else:
            assert block.language in ("text", "json", "toctree", "include"), f"{page}: {block.language}"


def command_lines(block: Block) -> Iterator[str]:
    """Yield the commands of a block: all lines of bash, those after a prompt of a console."""
    body = block.body.replace("\\\n", " ")
    for line in body.splitlines():
        if block.language == "console" and not line.startswith("$ "):
            continue
        if line.strip() and not line.strip().startswith("#"):
            yield line.removeprefix("$ ").strip()


def run_line(
    line: str,
    folder: Path,
    written: set[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Run a command; campaigns that the page does not write itself are ended where all their input is checked."""
    line = line.replace(".venv/bin/", "")
    program, *words = shlex.split(line, comments=True)
    words = words[: words.index(">")] if ">" in words else words
    if program == "make":
        assert re.search(rf"^{words[0]}:", (ROOT / "Makefile").read_text(), re.MULTILINE), line
    elif program == "python" and words[0].endswith(".py"):
        path = {**os.environ, "PYTHONPATH": python_path(folder)}
        assert subprocess.run([sys.executable, *words], cwd=folder, env=path, check=False).returncode == 0, line
    elif not line.startswith(NOT_RUN):
        assert program == "boresight", line
        with monkeypatch.context() as patch:
            if not written & set(words):
                stop_before_long(patch)
            if "--clear" in words:
                shutil.copytree(Path(os.environ["BORESIGHT_CACHE"]) / words[-1], folder / "cache" / words[-1])
                patch.setenv("BORESIGHT_CACHE", str(folder / "cache"))
            assert run_command(words) == 0 or lacks_something(capsys), line


def lacks_something(capsys: pytest.CaptureFixture[str]) -> bool:
    """Whether a command ended because data or a package are missing here; its words were right."""
    told = capsys.readouterr().err
    return bool(re.search(r"was not found; looked for|BORESIGHT_DATA|pip install|(is|are) missing[,:] ", told))


def check_yaml(block: Block) -> None:
    """Check the keys and values of a file or a part of one by the schema; a part may lack what is required."""
    content = YAML(typ="safe").load(block.body) or {}
    campaign = set(content) <= {*CampaignSpec.model_fields, "set", "extends"} - {"name", "description"}
    scenario = set(content) <= {*ScenarioSpec.model_fields, "extends"}
    assert campaign or scenario, f"keys of no file: {sorted(content)}"
    jsonschema.validate({"extends": "another", **content}, json_schema("scenario" if scenario else "campaign"))


def run_python(block: Block, names: dict[str, object], monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a script with the names of the page's earlier ones to its end, or to where it would take long."""
    try:
        with monkeypatch.context() as patch:
            stop_before_long(patch)
            exec(compile(block.body, "a block", "exec"), names)  # noqa: S102
    except ReachedError:
        pass
    except ModuleNotFoundError as error:
        assert error.name in NOT_INSTALLED, block.body

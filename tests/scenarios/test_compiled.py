"""Machine code is kept while the meaning of the sources is the same, and is never that of other sources."""

from __future__ import annotations

import ast
import fcntl
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from boresight import scenarios
from boresight.scenarios.compiled import source_key

ROOT = Path(scenarios.__file__).parents[1]
FOLDERS = [
    path.parent
    for package in ("scenarios", "renderers", "estimators", "reports", "campaign")
    for path in sorted((ROOT / package).rglob("*.py"))
    if "kernel, inner = compiler(" in path.read_text()
]

SOURCE = '''"""Kernels."""

from pathlib import Path

from boresight.scenarios.compiled import compiler

kernel, inner = compiler(Path(__file__).parent)
FACTOR = 2.0


@inner
def times(x):
    """Multiply."""
    return FACTOR * x


@kernel
def twice(x):
    return times(x) + 0.0


def in_python(x):
    return x
'''
SAME = {
    "a comment": SOURCE.replace("    return FACTOR", "    # Why.\n\n    return FACTOR"),
    "a docstring": SOURCE.replace("Multiply.", "Multiply by a constant.").replace("Kernels.", "Two\nkernels."),
    "no docstring": SOURCE.replace('    """Multiply."""\n', ""),
    "a Python function": SOURCE.replace("    return x\n", "    return x + 1\n"),
}
OTHER = {
    "a constant": SOURCE.replace("FACTOR = 2.0", "FACTOR = 3.0"),
    "a kernel": SOURCE.replace("FACTOR * x", "FACTOR * x * 1.5"),
    "a number in a kernel": SOURCE.replace("+ 0.0", "+ 2.0 * x * 0.5"),
    "an import": SOURCE.replace("from pathlib", "import math\nfrom pathlib"),
    "an inner function": SOURCE.replace(
        "    return times(x)", "    def own(y):\n        return y\n    return times(x)"
    ),
}


def write(folder: Path, source: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "kernels_of_test.py").write_text(source)
    return folder


@pytest.mark.parametrize("what", SAME)
def test_what_kernels_cannot_use_leaves_the_key(tmp_path, what):
    assert source_key(write(tmp_path, SAME[what])) == source_key(write(tmp_path, SOURCE))


@pytest.mark.parametrize("what", OTHER)
def test_what_kernels_use_changes_the_key(tmp_path, what):
    assert source_key(write(tmp_path, OTHER[what])) != source_key(write(tmp_path, SOURCE))


def test_a_python_function_that_makes_a_constant_changes_the_key(tmp_path):
    made = "\n\nMADE = in_python(2.0)\n"
    before = source_key(write(tmp_path, SOURCE + made))
    assert source_key(write(tmp_path, SAME["a Python function"] + made)) != before


def test_a_file_more_changes_the_key(tmp_path):
    before = source_key(write(tmp_path, SOURCE))
    (tmp_path / "other.py").write_text("SIZE = 3\n")
    assert source_key(tmp_path) != before


def calling(folder: Path, cache: Path) -> dict[str, object]:
    """Return what starts a process that calls the kernel; it prints the result and how many kernels it compiled."""
    code = (
        "from kernels_of_test import times, twice\nprint('begin', flush=True)\n"
        "print(twice(10.0), sum(sum(one.stats.cache_misses.values()) for one in (times, twice)))"
    )
    environment = {"PYTHONPATH": f"{folder}:{':'.join(sys.path)}", "NUMBA_CACHE_DIR": str(cache)}
    return {"args": [sys.executable, "-c", code], "env": environment, "text": True}


def called(folder: Path, cache: Path) -> tuple[float, int]:
    """Call the kernel in another process; return its result, and how many kernels were compiled rather than read."""
    done = subprocess.run(**calling(folder, cache), capture_output=True, check=True)
    _, result, compiled = done.stdout.split()
    return float(result), int(compiled)


def test_machine_code_is_read_after_a_comment_and_in_another_checkout_but_not_after_a_change(tmp_path):
    cache = tmp_path / "cache"
    assert called(write(tmp_path / "one", SOURCE), cache) == (20.0, 2)
    assert called(write(tmp_path / "two", SAME["a comment"]), cache) == (20.0, 0)
    assert called(write(tmp_path / "one", OTHER["a constant"]), cache) == (30.0, 2)


def test_of_two_processes_one_compiles_and_the_other_reads(tmp_path):
    """Both come to the first call while the lock is held by this process."""
    folder, cache = write(tmp_path / "one", SOURCE), tmp_path / "cache"
    place = cache / source_key(folder)
    place.mkdir(parents=True)
    with (place / "lock").open("a") as lock, ExitStack() as ended:
        fcntl.flock(lock, fcntl.LOCK_EX)
        both = [ended.enter_context(subprocess.Popen(**calling(folder, cache), stdout=subprocess.PIPE)) for _ in "ab"]
        assert [process.stdout.readline() for process in both] == ["begin\n"] * 2
        with pytest.raises(subprocess.TimeoutExpired):
            both[0].wait(0.5)
        fcntl.flock(lock, fcntl.LOCK_UN)
        results = [process.communicate(timeout=60)[0].split() for process in both]
    assert sorted(results) == [["20.0", "0"], ["20.0", "2"]]


def test_a_kernel_for_kernels_refuses_python(tmp_path):
    """Also once another kernel has called it: there is no code that could take the arguments."""
    process = calling(write(tmp_path / "one", SOURCE), tmp_path / "cache")
    process["args"][-1] = (
        "from kernels_of_test import times, twice\n"
        "for ready in (lambda: None, lambda: twice(10.0)):\n"
        "    ready()\n"
        "    try: times(10.0)\n"
        "    except TypeError as error: print(error)"
    )
    done = subprocess.run(**process, capture_output=True, check=True)
    assert done.stdout == "times is called by kernels only\n" * 2


def borrowed(folder: Path) -> set[str]:
    """Return the names in kernels of a folder that come from modules of boresight outside it."""
    found, package = set(), ".".join(("boresight", *folder.relative_to(ROOT).parts))
    for path in folder.glob("*.py"):
        tree = ast.parse(path.read_text())
        foreign = {
            alias.asname or alias.name
            for node in tree.body
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("boresight.")
            if not f"{node.module}.".startswith(f"{package}.")
            for alias in node.names
        }
        for node in tree.body:
            decorators = {ast.unparse(one) for one in getattr(node, "decorator_list", ())}
            if isinstance(node, ast.FunctionDef) and decorators & {"kernel", "inner"}:
                inside = [one for part in node.body for one in ast.walk(part)]
                # The type of a local variable is not evaluated.
                types = {
                    id(part) for one in inside if isinstance(one, ast.AnnAssign) for part in ast.walk(one.annotation)
                }
                names = {one.id for one in inside if isinstance(one, ast.Name) and id(one) not in types}
                found |= {f"{path.name}: {node.name}: {name}" for name in names & foreign}
    return found


def test_kernels_use_nothing_from_outside_their_folder():
    """The key of the machine code is of the sources of the folder alone."""
    assert ROOT / "estimators/slam/adjustment/compiled" in FOLDERS
    assert {name for folder in FOLDERS for name in borrowed(folder)} == set()


def test_a_kernel_that_uses_something_from_outside_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    other = SOURCE.replace("FACTOR = 2.0", "from boresight.scenarios.constants import FACTOR")
    assert borrowed(write(tmp_path / "mine", other)) == {"kernels_of_test.py: times: FACTOR"}

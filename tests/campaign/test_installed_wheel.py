"""The wheel, built from this checkout and installed elsewhere, works without the checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from tiny_campaign import assert_same_results, write_campaign

ROOT = Path(__file__).parents[2]
PACKAGES = ("scenarios", "renderers", "estimators", "reports", "campaign")


def checked(*words: object, cwd: Path, **environment: str) -> str:
    """Run a command that must succeed, where nothing leads to the checkout or to the user's data."""
    kept = {k: v for k, v in os.environ.items() if k not in {"PYTHONPATH", "BORESIGHT_DATA", "PYTHONHOME"}}
    done = subprocess.run(
        [str(word) for word in words],
        cwd=cwd, env={**kept, **environment}, capture_output=True, text=True, check=False, timeout=180,
    )  # fmt: skip
    assert done.returncode == 0, f"{words}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from a copy of the source, so that the checkout stays as it is."""
    folder = tmp_path_factory.mktemp("build")
    source = folder / "source"
    source.mkdir()
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy2(ROOT / name, source)
    for name in (*PACKAGES, "tests"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    checked(sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", folder, source, cwd=folder)
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the wheel into an environment of its own, which borrows the dependencies of this one.

    A plain path in a .pth file lends the packages, but not the editable install of the checkout: its own .pth
    is not read from there.
    """
    folder = tmp_path_factory.mktemp("venv") / "venv"
    checked(sys.executable, "-m", "venv", "--without-pip", folder, cwd=folder.parent)
    python = folder / "bin" / "python"
    site = Path(checked(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip())
    (site / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = [sys.executable, "-m", "pip", "--python", python, "--disable-pip-version-check", "--quiet"]
    checked(*pip, "install", "--no-deps", "--no-index", "--force-reinstall", wheel, cwd=folder)
    return folder


def test_the_wheel_holds_the_data_and_no_tests(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == {"boresight"}
    assert not [name for name in names if "test" in Path(name).name.lower() or "conftest" in name]
    files = [path for package in PACKAGES for path in (ROOT / package).rglob("*") if "__pycache__" not in path.parts]
    kept = {".py", ".pyi", ".yaml", ".html", ".css", ".js", ".toml", ".typed", ".npz", ".json", ".jsonl"}
    inside = [path.relative_to(ROOT).as_posix() for path in files if path.suffix in kept]
    expected = {f"boresight/{name.removeprefix('campaign/api/')}" for name in inside}
    assert expected <= set(names), f"left out: {sorted(expected - set(names))}"
    for name in ("__init__.pyi", "campaign/catalog/quickstart.yaml", "reports/pages/page.html"):
        assert f"boresight/{name}" in expected
    assert any(name.startswith("boresight/reports/published/") and name.endswith(".yaml") for name in expected)
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_every_package_comes_from_the_wheel(environment, tmp_path):
    names = ["boresight", *(f"boresight.{name}" for name in PACKAGES)]
    code = f"import importlib; print(*(importlib.import_module(n).__file__ for n in {names}), sep='\\n')"
    found = checked(environment / "bin" / "python", "-c", code, cwd=tmp_path).split()
    assert len(found) == len(names)
    assert all(Path(path).is_relative_to(environment) for path in found), found


def test_the_command_lists_the_catalogue_elsewhere(environment, tmp_path):
    text = checked(environment / "bin" / "boresight", "list", "--all", cwd=tmp_path)
    assert all(name in text for name in ("quickstart", "rowell2015-simulated", "landmark-harris"))
    assert not list(tmp_path.iterdir())


@pytest.mark.long
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_campaign_runs_elsewhere_with_the_same_rows(environment, tiny_run, tmp_path, jobs):
    file = write_campaign(tmp_path / "mine")
    cache = str(tmp_path / "cache")
    command = [environment / "bin" / "boresight", "run", file, "--jobs", jobs, "--worst", "0", "--out", "run"]
    text = checked(*command, cwd=tmp_path, BORESIGHT_CACHE=cache)
    assert "building the landmark database" in text
    assert (tmp_path / "run" / "report" / "report.html").is_file()
    assert_same_results(tiny_run.folder, tmp_path / "run")
    manifest = (tmp_path / "run" / "manifest.json").read_text()
    assert '"commit": ""' in manifest, "it runs from no checkout"


def test_modules_of_a_user_with_the_names_of_our_folders_are_in_nobodys_way(environment, tmp_path):
    (tmp_path / "campaign.py").write_text("raise RuntimeError('mine')\n")
    for name in ("reports", "scenarios", "estimators", "renderers"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('mine')\n")
    code = "import boresight; print(boresight.render('quickstart', overrides=['body.detail=null']).image.shape)"
    (tmp_path / "mine.py").write_text(code)
    assert checked(environment / "bin" / "python", "mine.py", cwd=tmp_path) == "(512, 512)\n"
    assert "quickstart" in checked(environment / "bin" / "python", "-m", "boresight", "list", cwd=tmp_path)


@pytest.mark.long
def test_the_source_distribution_builds_the_same_wheel(wheel, tmp_path):
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", tmp_path]
    checked(*build, "--sdist", wheel.parent / "source", cwd=tmp_path)
    (archive,) = tmp_path.glob("*.tar.gz")
    shutil.unpack_archive(archive, tmp_path / "unpacked")
    (source,) = (tmp_path / "unpacked").iterdir()
    checked(*build, "--wheel", source, cwd=tmp_path)
    (again,) = tmp_path.glob("*.whl")
    names = [sorted(zipfile.ZipFile(one).namelist()) for one in (wheel, again)]
    assert names[0] == names[1]

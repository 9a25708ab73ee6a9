"""The wheel works outside the checkout: data of the packages included, nothing of the checkout needed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pandas as pd
import pytest

ROOT = Path(__file__).parents[2]
PARTS = ("scenarios", "renderers", "estimators", "reports", "campaign")
CAMPAIGN = """
scenarios: [scene.yaml]
estimators:
  - prior
  - landmark-harris: {database: {images: 25, min_observations: 3, clusters: {seed_radius_m: 8}}}
trials: 3
seed: 5
"""
SCENE = """
body: {detail: {facets: 12000, boulders: {count: 300, min_diameter_m: 15, max_diameter_m: 60}}}
camera: {width_px: 128, height_px: 128, fov_deg: 18.3}
viewpoint: {range_m: 2000}
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build from a copy, so that no build folder appears in the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    source.mkdir()
    for part in PARTS:
        shutil.copytree(ROOT / part, source / part, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install into an empty environment elsewhere; only the dependencies are lent, as plain packages."""
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder / "venv", symlinks=True)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder / "venv")}))
    command = [sys.executable, "-m", "pip", "--python", str(folder / "venv" / "bin" / "python"), "install", "--no-deps"]
    subprocess.run([*command, "--no-index", "--quiet", str(wheel)], check=True)
    lent = folder / "lent"
    lent.mkdir()
    for item in Path(sysconfig.get_path("purelib")).iterdir():
        if "boresight" not in item.name and item.suffix != ".pth":
            (lent / item.name).symlink_to(item)
    (site / "lent.pth").write_text(f"{lent}\n")
    return folder


def run(installed: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key not in ("BORESIGHT_DATA", "PYTHONPATH")}
    environment["BORESIGHT_CACHE"] = str(installed / "cache")
    command = [str(installed / "venv" / "bin" / "boresight"), *arguments]
    return subprocess.run(command, cwd=installed, env=environment, capture_output=True, text=True, check=False)


def test_the_wheel_holds_the_data_of_the_packages_and_no_tests(wheel: Path):
    names = zipfile.ZipFile(wheel).namelist()
    for name in (
        "campaign/catalog/quickstart.yaml",
        "scenarios/catalog/quickstart.yaml",
        "reports/published/rowell2015.yaml",
        "reports/page.html",
        "reports/page.css",
    ):
        assert name in names
    assert not [name for name in names if name.startswith("tests") or "/test_" in name]
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == set(PARTS)


def test_it_runs_from_the_installed_files(installed: Path):
    code = "import campaign, scenarios, renderers, estimators, reports as r; print(campaign.__file__, r.__file__)"
    done = subprocess.run(
        [str(installed / "venv" / "bin" / "python"), "-c", code],
        cwd=installed,
        capture_output=True,
        text=True,
        check=True,
    )
    assert all(path.startswith(str(installed / "venv")) for path in done.stdout.split())


def test_list_names_every_campaign_and_scenario(installed: Path):
    done = run(installed, "list")
    assert done.returncode == 0, done.stderr
    for name in ("quickstart", "rowell2015-simulated", "navcam67p-real", "itokawa-2km-lambert"):
        assert name in done.stdout


def test_a_tiny_campaign_runs_to_its_report(installed: Path):
    (installed / "scene.yaml").write_text(SCENE)
    (installed / "tiny.yaml").write_text(CAMPAIGN)
    done = run(installed, "run", "tiny.yaml", "--jobs", "1", "--out", "out")
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert len(pd.read_parquet(installed / "out" / "rows")) == 6
    assert (installed / "out" / "report" / "report.html").exists()
    assert '"commit": ""' in (installed / "out" / "manifest.json").read_text()

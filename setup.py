"""The five folders are packages of `boresight`: a `campaign.py` or `reports/` of a user's own is another module."""

from setuptools import find_namespace_packages, setup

FOLDERS = ("scenarios", "renderers", "estimators", "reports", "campaign")

found = find_namespace_packages(
    include=[pattern for folder in FOLDERS for pattern in (folder, f"{folder}.*")],
    exclude=["campaign.api", "*.__pycache__"],
)
setup(
    packages=["boresight", *(f"boresight.{name}" for name in found)],
    package_dir={"boresight": "campaign/api", **{f"boresight.{folder}": folder for folder in FOLDERS}},
)

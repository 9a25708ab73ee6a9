"""All that blocks of a campaign are worked out from, as files by content hash."""

from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath

from campaign.imaging.real_images import image_files
from campaign.resolved import ResolvedCampaign
from scenarios.bodies import EMBEDDED
from scenarios.data import find_data_file
from scenarios.errors import BoresightError
from scenarios.load import LoadedScenario
from scenarios.onboard import onboard_spec

CAMPAIGN, DATA, RUN = "campaign.pickle", "data", "run"


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """Files by SHA-256, and an index that names them.

    Parameters
    ----------
    digest
        SHA-256 of the index.
    assets
        SHA-256 to content: every file, and the index, which maps relative paths to SHA-256.
    """

    digest: str
    assets: Mapping[str, bytes]

    @property
    def size_bytes(self) -> int:
        """Size of it all."""
        return sum(map(len, self.assets.values()))


def bundle_of(campaign: ResolvedCampaign, run: Path) -> Bundle:
    """Gather the campaign, the data that its scenarios read, and the products of its run folder.

    Raises
    ------
    BoresightError
        If a file is named by an absolute path, which means nothing on another machine.
    """
    _ = campaign.digest  # worked out here once: where the bundle is opened it holds for both
    contents = {CAMPAIGN: pickle.dumps(campaign, protocol=5)}
    for scenario in campaign.scenarios:
        contents |= {f"{DATA}/{name}": path.read_bytes() for name, path in _data(scenario)}
    for path in sorted((run / "products").rglob("*")):
        if path.is_file():
            contents[f"{RUN}/products/{path.relative_to(run / 'products').as_posix()}"] = path.read_bytes()
    index = {name: _sha256(content) for name, content in sorted(contents.items())}
    written = json.dumps(index, sort_keys=True).encode()
    assets = {index[name]: content for name, content in contents.items()}
    return Bundle(_sha256(written), {**assets, _sha256(written): written})


def _data(scenario: LoadedScenario) -> Iterator[tuple[str, Path]]:
    """Yield the files of a scenario as it names them, and where they are here."""
    spec, dirs = scenario.spec, scenario.search_dirs
    for shape in dict.fromkeys((spec.body.shape, onboard_spec(spec).body.shape)):
        if shape not in EMBEDDED:
            yield _portable(shape, scenario), find_data_file(shape, dirs, "shapes", "body.shape")
    for name, path in image_files(scenario):
        yield _portable(name, scenario), path


def _portable(name: str, scenario: LoadedScenario) -> str:
    """Return a name that means the same in another folder."""
    parts = PurePath(name).parts
    if PurePath(name).is_absolute() or ".." in parts:
        raise BoresightError(
            f"{scenario.path}: {name}: means nothing on another machine: name it relative to the scenario's file or to"
            " BORESIGHT_DATA to run on a cluster"
        )
    return PurePath(name).as_posix()


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()

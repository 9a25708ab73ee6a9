"""The request of a run, and its manifest: what was asked, from which versions, on which machine."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from boresight.campaign.imaging.credits import credit_lines
from boresight.campaign.imaging.real_images import left_out_notes, open_images
from boresight.campaign.machine import describe, package_versions
from boresight.campaign.products import BuiltProduct, MissingProduct, OnboardShape, Prepared
from boresight.campaign.products.assets import product_kind
from boresight.campaign.resolved import ResolvedCampaign
from boresight.campaign.store import KEY, next_start
from boresight.reports.schema.tables import FORMAT_VERSION
from boresight.scenarios.load import canonical_json

_DRAFT = (
    "A draft of scale {:g}: fewer trials, data bases of fewer images, shorter arcs of images, and fewer sets of images,"
    " than are meant."
)
_EMBEDDED = "On embedded bodies, which give values but no verdicts"


@dataclass(frozen=True, slots=True)
class Cluster:
    """A Dask cluster: the address of a scheduler, or a number of worker processes on this machine."""

    scheduler: str = ""
    local: int = 0


@dataclass(frozen=True, slots=True)
class RunRequest:
    """Settings of a run. Of them only ``trials``, and ``limit_s`` if a method exceeds it, change the stored rows.

    ``out`` is kept as an absolute path, because a method may change the working directory. ``trials`` are those of each
    scenario, ``jobs`` worker processes. ``command`` is the command line, for the manifest. Without a ``cluster``,
    processes of this machine run the trials. An estimator that works at a trial for ``limit_s`` is stopped, which is an
    error; None: no limit.
    """

    out: Path
    trials: int
    jobs: int
    keep_images: bool = False
    command: str = ""
    cluster: Cluster | None = None
    limit_s: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "out", self.out.absolute())


def make_manifest(
    campaign: ResolvedCampaign,
    request: RunRequest,
    products: Sequence[Prepared],
    previous: Mapping[str, Any] | None,
) -> dict[str, object]:
    """Describe a run before its first trial; what an earlier start of it asked for is not forgotten."""
    earlier = previous or {}
    return {
        "format": FORMAT_VERSION,
        "digest": campaign.digest,
        "identity": campaign.identity,
        "name": campaign.spec.name,
        "title": f"{campaign.spec.title or campaign.spec.name}{' (embedded bodies)' if campaign.embedded else ''}",
        "description": campaign.spec.description,
        "report": campaign.spec.report,
        "requirements": [asked.model_dump(mode="json") for asked in campaign.spec.requirements],
        "seed": campaign.seed,
        "trials": max(request.trials, int(earlier.get("trials", 0))),
        "looked": bool(earlier.get("looked")) or 0 < int(earlier.get("trials", 0)) < request.trials,
        "campaign": campaign.as_written(),
        "overrides": list(campaign.overrides),
        "draft": campaign.draft,
        "embedded": list(campaign.embedded),
        "files": {s.spec.name: [str(s.path), *map(str, s.search_dirs)] for s in campaign.scenarios},
        "estimators": list(campaign.labels),
        "scenarios": {s.spec.name: json.loads(canonical_json(s.spec)) for s in campaign.scenarios},
        "credits": sorted({line for scenario in campaign.scenarios for line in credit_lines(scenario.spec)}),
        "grid": _grid(campaign),
        "created": earlier.get("created") or now(),
        KEY: next_start(request.out),
        "command": request.command,
        "trial_limit_s": request.limit_s,
        "commit": commit_here(),
        "versions": package_versions(),
        "machine": {**describe(), "variant": campaign.variant},
        "left_out": {s.spec.name: dict(open_images(s).left_out) for s in campaign.scenarios if s.spec.images},
        "notes": [
            *(note for s in campaign.scenarios for note in left_out_notes(s)),
            *([_DRAFT.format(campaign.draft)] if campaign.draft < 1.0 else []),
            *([f"{_EMBEDDED}: {', '.join(campaign.embedded)}."] if campaign.embedded else []),
            *missing_notes(products),
        ],
        "products": [_product(request.out, product) for product in products if isinstance(product, BuiltProduct)],
        "shapes": [asdict(shape) for shape in products if isinstance(shape, OnboardShape)],
    }


def updated(manifest: Mapping[str, object], **changes: object) -> dict[str, object]:
    """Return a manifest with some entries replaced and the time of the change."""
    return {**manifest, **changes, "updated": now(manifest)}


def now(manifest: Mapping[str, object] | None = None) -> str:
    """Return the UTC time to the second, never earlier than in the previous manifest."""
    before = [str((manifest or {}).get(key) or "") for key in ("created", "finished", "updated")]
    return max(datetime.now(UTC).isoformat(timespec="seconds"), *before)


def missing_notes(products: Sequence[Prepared]) -> list[str]:
    """Say of each product that cannot be made who goes without it, and why."""
    return [
        f"all trials of {missing.estimator} in {missing.scenario} are errors: {missing.reason}"
        for missing in products
        if isinstance(missing, MissingProduct)
    ]


def _grid(campaign: ResolvedCampaign) -> dict[str, object] | None:
    """Describe the campaign's grid: axes, their levels, and the levels of each scenario."""
    grid = campaign.spec.grid
    if grid is None:
        return None
    axes = [
        {"name": name, "label": axis.label or name, "levels": list(axis.overrides), "values": axis.values}
        for name, axis in grid.axes.items()
    ]
    return {
        "design": grid.design,
        "axes": axes,
        "scenarios": [{"name": name, **asdict(own)} for name, own in campaign.variations.items()],
    }


def _product(run: Path, product: BuiltProduct) -> dict[str, object]:
    folder, kind = run / "products" / product.folder, product_kind(product.kind)
    built = json.loads((folder / "built.json").read_text(encoding="utf-8"))
    return {
        "kind": product.kind,
        "scenario": product.scenario,
        "estimator": product.estimator,
        "database": product.database,
        "folder": f"products/{folder.name}",
        "bytes": sum(file.stat().st_size for file in folder.iterdir() if file.name != "built.json"),
        **kind.about(kind.load(folder)),
        **built,
    }


def commit_here() -> str:
    """Return the commit of the checkout that runs; empty outside a checkout."""
    here = Path(__file__).parent
    try:
        found = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12", "--match="],  # noqa: S607  git is where the user has it
            cwd=here, capture_output=True, text=True, timeout=10, check=False,
        )  # fmt: skip
        tracked = subprocess.run(  # noqa: S603
            ["git", "ls-files", "--error-unmatch", Path(__file__).name],  # noqa: S607
            cwd=here, capture_output=True, timeout=10, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return found.stdout.strip() if found.returncode == 0 and tracked.returncode == 0 else ""

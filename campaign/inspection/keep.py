"""Everything that came about in a case, written beside its page: tables, images, estimate."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from campaign.inspection.recompute import Recomputed
from campaign.inspection.show import Kept, Show
from campaign.store.columns import schema
from campaign.trial.kept_images import write_image
from campaign.trial.kind import Record
from scenarios.atomic import write_atomically, write_text


def keep(again: Recomputed, show: Show | None, folder: Path) -> list[Path]:
    """Write the tables of a case as Parquet, what its estimator saw as TIFF, and what it returned as JSON."""
    kept = [_table(name, records, folder) for name, records in again.records.items() if records]
    shown = Kept() if show is None else show.kept(again.shown)
    for name, image in shown.images.items():
        kept.append(folder / f"{name}.tiff")
        write_image(kept[-1], image)
    if shown.estimate is not None:
        kept.append(folder / "estimate.json")
        write_text(kept[-1], json.dumps(shown.estimate, indent=1) + "\n")
    return kept


def _table(name: str, records: Sequence[Record], folder: Path) -> Path:
    path = folder / "tables" / f"{name}.parquet"
    table = pa.Table.from_pylist([dict(record) for record in records], schema=schema(name))
    write_atomically(path, lambda temporary: pq.write_table(table, temporary))
    return path

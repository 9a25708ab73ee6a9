"""The run folder: Parquet tables in blocks of trials, a manifest, a lock.

Everything that a report needs is here, and nothing is counted twice: a block's detail tables are written
before its rows, and only a block whose rows are complete counts as done.
"""

from boresight.campaign.store.folder import RunFolder, run_lock
from boresight.reports.schema.tables import TABLES

__all__ = ["TABLES", "RunFolder", "run_lock"]

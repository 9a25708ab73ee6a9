"""Runs on a Dask cluster whose workers share no file system with who started the run.

``bundle`` gathers all that blocks of trials are worked out from, by content hash; ``assets`` lets the scheduler hold it
and workers fetch what they do not have; ``work`` is what a worker does with a block; ``backend`` and ``cluster`` let
joblib spread blocks over the workers. Nothing here may change a row.
"""

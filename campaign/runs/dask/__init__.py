"""Runs on a Dask cluster whose workers share no file system with the machine that started the run.

``bundle`` collects the files that blocks of trials need, which workers fetch from the scheduler; ``work`` computes a
block in a worker; ``cluster`` distributes blocks over the workers. Nothing here may change a row.
"""

"""Pages of papers, with figures and tables from stored runs; each paper is a module that defines ``PAPER``."""

from boresight.campaign.catalog import PAPERS

__all__ = ["PAPERS"]

"""Pages of papers, with figures and tables from stored runs; each paper is a module that defines ``PAPER``."""

PAPERS = ("cheng2003", "delpech2015", "rowell2015")

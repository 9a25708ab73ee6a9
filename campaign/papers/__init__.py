"""The figures and the table of a paper, gathered from stored runs; each paper is a module that defines ``PAPER``."""

PAPERS = ("cheng2003", "delpech2015", "rowell2015")

"""The figures and the table of a paper, gathered from stored runs; each paper is a module that defines ``PAPER``."""

PAPERS = ("delpech2015", "rowell2015")

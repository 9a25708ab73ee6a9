"""The figures and the table of a paper, gathered from stored runs."""

PAPERS = ("rowell2015",)

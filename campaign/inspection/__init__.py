"""Inspection of single cases of a stored run: recomputed, compared with the stored rows, drawn and written.

`recompute` selects cases by name or rank, runs and compares one, `show` defines the displays of a kind of trial, among
them a three-dimensional view of a run, and `build` writes a page for each case.
"""

"""Campaigns that come with boresight: one YAML file each, those of a paper under its name."""

PAPERS = ("cheng2003", "delpech2015", "rowell2015")
"""Papers, by first author and year."""

PAGES = (*PAPERS, "reality")
"""What `boresight figures` draws: papers, and real data next to simulated ones."""

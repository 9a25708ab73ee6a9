"""The command line: it only wires the steps together."""

from boresight.campaign.cli.main import main

__all__ = ["main"]

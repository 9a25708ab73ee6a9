"""Data sets of missions: fetched from the net, and craters named in their images."""

"""Simultaneous localisation and mapping from tracks of points (Delpech et al. 2015, and beyond)."""

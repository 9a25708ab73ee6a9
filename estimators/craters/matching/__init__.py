"""Craters that two images have in common: the three modes of Cheng et al. (2003), their hybrid, and a vote."""

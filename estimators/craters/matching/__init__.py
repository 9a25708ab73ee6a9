"""Matching of craters between two images: the three modes of Cheng et al. (2003), their hybrid, and a vote."""

"""Crater navigation after Cheng et al. (2003): detection, matching, database, pose, and the chain to an orbit."""

"""Crater navigation after Cheng et al. (2003): detection, matching, data base."""

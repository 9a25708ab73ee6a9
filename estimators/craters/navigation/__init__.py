"""The chain of crater navigation after Cheng et al. (2003): images in, an orbit out."""

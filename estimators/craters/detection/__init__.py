"""Detection of craters after Cheng et al. (2003): edges, grouping, ellipse fit, refinement, confidence."""

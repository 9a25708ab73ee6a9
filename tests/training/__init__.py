"""Training of what estimators learn: the ground that they learn from, and how it is done."""

"""One folder for each kind of trial: the only code that sees renderer, truth and estimator together."""

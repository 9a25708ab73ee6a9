"""Every key of the schema: scenarios in which it applies, another value of it, and what an estimator sees of both."""

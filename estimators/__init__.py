"""What is worked out: estimators on one contract."""

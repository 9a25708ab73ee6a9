"""Estimators that compare the whole image with a rendering instead of points in it."""

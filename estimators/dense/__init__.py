"""Estimators that register a rendering with the whole image instead of matching points."""

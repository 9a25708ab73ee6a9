"""Craters as the world has them."""

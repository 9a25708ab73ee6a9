"""SPICE kernels, and the geometry of missions that they hold."""

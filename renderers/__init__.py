"""Sensor images: rendering, detector noise, lens rectification, and readers of real images and SPICE kernels."""

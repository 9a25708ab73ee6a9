"""Orbit determination by craters after Cheng et al. (2003): a batch filter of images and radiometric data."""

"""Smoothers: fixed lag, batch, loop closure, with dynamics, and those of gtsam."""

"""Data association: predicted pixels with their covariance, gates, and outlier rejection."""

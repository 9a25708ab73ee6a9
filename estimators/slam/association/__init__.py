"""Which pixel is of which landmark: predictions with their covariance, gates, and rejection of outliers."""

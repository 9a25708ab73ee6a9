"""Joint adjustment of the real images of 67P: features, bundle adjustment, and the place of the shape."""

"""Recognition by feature descriptors of rendered images, as a baseline."""

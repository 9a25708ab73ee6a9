"""Recognition by descriptors: features of rendered images with their points on the body, as a baseline."""

"""What the sensors give: rendered images, detector, real images."""

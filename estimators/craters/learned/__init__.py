"""Detection of craters by ring templates and a small convolutional network."""

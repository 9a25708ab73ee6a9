"""The pose of one image by the craters of a data base."""

"""The crater database: numbering of craters over all images, their positions, and the files for orbit determination."""

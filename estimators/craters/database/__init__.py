"""One number for one crater over all images, where it lies, and the files that orbit determination reads."""

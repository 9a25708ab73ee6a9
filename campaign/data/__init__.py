"""Mission data: downloads of data sets, and crater detection in a real image with named craters."""

"""Detection of craters in a real image, beside the places where named craters should be."""

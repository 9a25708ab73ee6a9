"""Detection of craters by ring templates and a small network that verifies and places what they propose."""

"""A stored run, read back."""

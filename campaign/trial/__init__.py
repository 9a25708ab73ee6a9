"""What all kinds of trial share: the methods under test, their limits and faults, and scores."""

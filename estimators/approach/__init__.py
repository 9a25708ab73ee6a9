"""Position of a body from its brightness and its outline, for approach and departure."""

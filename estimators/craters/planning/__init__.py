"""Which images to take along an orbit, and the file that says so: the planning of Cheng et al. (2003)."""

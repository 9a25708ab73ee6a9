"""The chain of Cheng et al. (2003) from detected craters to an orbit, and around again when it is not accepted."""

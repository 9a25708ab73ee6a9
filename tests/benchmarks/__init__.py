"""How fast boresight is beside what one would use instead: ratios of one run, and their history."""

"""The pose from matched landmarks: closed form, non-linear refinement and outlier rounds (section 3.4)."""

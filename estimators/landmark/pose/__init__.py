"""Solve for the pose from matched landmarks: closed form, non-linear refinement and outlier removal (section 3.4)."""

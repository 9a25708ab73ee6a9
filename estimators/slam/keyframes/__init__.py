"""BA-SLAM: keyframes, bundle adjustment of a window, and the filter that predicts the motion between frames."""

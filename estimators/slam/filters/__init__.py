"""EKF-SLAM with anchored inverse depth, as published, consistent and iterated."""

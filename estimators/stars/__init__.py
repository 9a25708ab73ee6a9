"""Attitude of the camera from the stars in an image: detection, identification, Wahba's problem, and calibration."""

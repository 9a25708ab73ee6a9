"""Estimators of camera pose and orbit from images, behind one interface."""

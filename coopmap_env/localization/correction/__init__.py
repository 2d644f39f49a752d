"""Correction of camera poses after a motion, by fiducials (2.5)."""

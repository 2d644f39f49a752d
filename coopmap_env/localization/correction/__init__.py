"""Correction of camera poses after a motion, by fiducials (Section 2.5)."""

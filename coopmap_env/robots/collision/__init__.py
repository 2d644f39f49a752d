"""Collision checking of mounts: clearance, contact, motion planning, self-filtering."""

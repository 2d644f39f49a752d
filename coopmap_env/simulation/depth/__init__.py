"""Depth images by ray tracing (Embree)."""

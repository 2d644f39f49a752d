"""Confidence intervals, tests and bootstrap."""

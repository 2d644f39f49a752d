"""Learned policies and planners on the same test worlds."""

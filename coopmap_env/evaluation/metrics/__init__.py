"""Scores of maps against the true world."""

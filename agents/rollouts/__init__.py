"""Environments of a team as rows of a vectorised environment, in worker processes."""

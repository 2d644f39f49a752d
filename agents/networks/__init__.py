"""Networks: features of an observation, candidate scorer, pose policy."""

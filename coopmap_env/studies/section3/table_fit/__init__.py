"""The search of the camera, world and weights that the paper's Table 1 does not state."""

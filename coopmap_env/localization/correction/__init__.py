"""Motion correction (2.5): where a camera stands after a motion, by fiducials."""

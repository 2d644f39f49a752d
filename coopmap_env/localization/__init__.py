"""Where the robots and their cameras are: target registration (2.2) and motion correction (2.5)."""

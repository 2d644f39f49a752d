"""Target registration (Section 2.2): a robot's base pose, from scans of the known target."""

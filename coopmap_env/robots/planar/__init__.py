"""Where planar cameras can stand: the pose lattice, and the cells that free paths reach."""

"""Target registration (Section 2.2) and motion correction (Section 2.5)."""

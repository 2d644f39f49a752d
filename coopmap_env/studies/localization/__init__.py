"""Target registration (2.2) and motion correction (2.5) in the field."""

"""Target registration (2.2): where a robot stands, by the known target among what it has seen."""

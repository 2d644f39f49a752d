"""Episodes as offline pages."""

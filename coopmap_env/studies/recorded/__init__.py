"""The map on recorded laser scans."""

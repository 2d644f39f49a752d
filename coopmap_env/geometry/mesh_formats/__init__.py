"""Readers of mesh formats: from the content of a file to vertices and faces, one format a file."""

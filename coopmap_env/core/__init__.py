"""Utilities without domain knowledge: files, settings, kernels, optional imports, progress."""

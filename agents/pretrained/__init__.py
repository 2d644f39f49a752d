"""Trained policies as files, and those that ship with coopmap."""

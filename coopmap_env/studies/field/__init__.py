"""Policies on field scenes, OctoMap, and a real stereo pair."""

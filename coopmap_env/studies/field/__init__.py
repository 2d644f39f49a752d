"""Policies in the field environment, a comparison with OctoMap, and a real stereo pair."""

"""Training on Stable-Baselines3."""

"""Training on Ray's RLlib."""

"""A training as a chain of segments; imitation."""

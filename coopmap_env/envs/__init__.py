"""The environments: orchestration, actions, observations, rewards, rendering."""

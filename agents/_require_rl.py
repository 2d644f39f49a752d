"""Imported first by all modules that need torch: a missing one is named with its pip command."""

from coopmap_env.core.extras import import_optional

for module in ("torch", "stable_baselines3", "safetensors"):
    import_optional(module, "rl")

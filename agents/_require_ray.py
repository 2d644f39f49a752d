"""Imported first by the package that needs Ray: a missing one is named with its pip command."""

import coopmap_agents._require_rl  # noqa: F401 - Ray takes seconds even where torch is missing
from coopmap_env.core.extras import import_optional

import_optional("ray.rllib", "ray")

"""Imported first by the package that needs BenchMARL: a missing one is named with its command."""

import coopmap_agents._require_rl  # noqa: F401
from coopmap_env.core.extras import import_optional

import_optional("benchmarl", "benchmarl")

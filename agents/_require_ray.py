"""Imported first by the package that needs Ray: a missing one is named with its pip command."""

from coopmap_env.core.extras import import_optional

import_optional("ray.rllib", "ray")

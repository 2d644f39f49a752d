"""The page of each benchmark family: bound, clairvoyant references, planners, learned policies.

::

    python -m coopmap_env.studies.families crowded --worlds 40 --out results/families

plays all policies on worlds of a family, with bounds and clairvoyant references, and prints its
table: what is shown at the end, efficiencies, the difference to the best one-step
planner world by world, means with 95 % intervals. `--pages docs/families` writes the page. At
the end, it applies the rule by which families are admitted (`admission`).
"""

from coopmap_env.studies.families.page import page_text
from coopmap_env.studies.families.play import PLAYED_POLICIES, Entry, play_family
from coopmap_env.studies.families.table import table_of

__all__ = ["PLAYED_POLICIES", "Entry", "page_text", "play_family", "table_of"]

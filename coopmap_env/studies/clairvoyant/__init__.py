"""What a policy would show that knew the true world: a reference between planners and the bound.

::

    python -m coopmap_env.studies.clairvoyant rooms --scans 48 --worlds 6

`ClairvoyantGreedy` and `ClairvoyantLookAhead` know the true planar world and keep every constraint
of policies that do not: they move through what the belief knows to be free, within reach, by
actions of the same mode. They choose by the cells that are truly ``shown``, not by the belief. So
they say how much of the gap to the upper bound (`coopmap_env.evaluation.bounds`) a policy could
close that predicted the world perfectly. They are references, not policies: the package is out of
reach of planners and agents, and they have no name on the command line.

`ClairvoyantFieldGreedy` and `ClairvoyantFieldLookAhead` are the same for field worlds, where they
choose among poses of a finite set by the surface that these truly cover. `studies.families` plays
them.

The study plays the planar ones and planners on training worlds, and prints what each shows at the
end, its efficiency (what it shows beyond the start, as a fraction of what the bound allows), that
of the area under the curve, and the parts of its gap (`split_gap`), means over the worlds with 95 %
intervals.
"""

from coopmap_env.studies.clairvoyant.field_policy import (
    N_DRAWN,
    ClairvoyantFieldGreedy,
    ClairvoyantFieldLookAhead,
    FieldLookAhead,
    surface_views,
    true_pose_sets,
)
from coopmap_env.studies.clairvoyant.gap import Gap, split_gap
from coopmap_env.studies.clairvoyant.jobs import CLAIRVOYANT, play_clairvoyant
from coopmap_env.studies.clairvoyant.policy import (
    ClairvoyantGreedy,
    ClairvoyantLookAhead,
    LookAhead,
)
from coopmap_env.studies.clairvoyant.study import play_worlds, summarise, table_lines

__all__ = [
    "CLAIRVOYANT",
    "N_DRAWN",
    "ClairvoyantFieldGreedy",
    "ClairvoyantFieldLookAhead",
    "ClairvoyantGreedy",
    "ClairvoyantLookAhead",
    "FieldLookAhead",
    "Gap",
    "LookAhead",
    "play_clairvoyant",
    "play_worlds",
    "split_gap",
    "summarise",
    "surface_views",
    "table_lines",
    "true_pose_sets",
]

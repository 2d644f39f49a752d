"""Vector environments beside single ones, over many random steps: equal to the last bit.

::

    python -m coopmap_env.studies.equality OUT.json --planar-steps 1000000 --field-steps 20000

Each `Case` is a vector environment and as many single environments. They are reset with the same
seeds and get the same actions, some of them random, others directed to what random ones seldom meet
(`ActionMaker`): collisions, rejections, masked candidates. The vector environment then plays the
same seeds and actions again. Observations, rewards, infos, ends, and what `SameStep` resets keep
must be the same bytes in all three, and so must the maps at the end. A difference ends its case,
and at the end the study with exit code 1. Finished cases are kept in the folder ``OUT.cases``: an
interrupted study goes on where it was, if the sources have not changed.

A step is one action of each robot of one world. Each is played three times.
"""

from coopmap_env.studies.equality.actions import ActionMaker
from coopmap_env.studies.equality.cases import Case, field_cases, planar_cases
from coopmap_env.studies.equality.play import Counts, play_case
from coopmap_env.studies.equality.shown import Difference, DifferenceError

__all__ = [
    "ActionMaker",
    "Case",
    "Counts",
    "Difference",
    "DifferenceError",
    "field_cases",
    "planar_cases",
    "play_case",
]

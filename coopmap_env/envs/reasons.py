"""Why an action was rejected."""

from coopmap_env.core.reasons import Reason


class RejectedReason(Reason):
    """Why the requested pose was rejected and the robot stayed; ``infos`` have the code.

    Examples
    --------
    ``RejectedReason(info["rejected_reason"]).words``
    """

    # planar: the results of `feasibility`, which a test compares with these
    NONE = 0
    OUTSIDE_WORLD = 1, "outside the world"
    GOAL_UNKNOWN = 2, "goal is unknown"
    GOAL_NOT_FREE = 3, "goal is not known to be free"
    NO_PATH = 4, "no path through known free space leads there"
    # both worlds, in "candidates" mode
    MASKED = 5, "candidate is masked out"
    # field, what a link would touch on its way: MASKED + `PredictedContact.kind`
    TOUCHES_MAP = 6, "a link would touch what is not known to be free"
    TOUCHES_ITSELF = 7, "a link would touch the own vehicle"
    TOUCHES_TEAMMATE = 8, "a link would touch a teammate"

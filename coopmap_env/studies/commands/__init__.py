"""The commands of the studies.

========================  =======================================================================
command                   study
========================  =======================================================================
``coopmap reproduce``     `studies.section3`, which includes `studies.recorded`; then
                          `studies.field`, in one report
``coopmap fit-table``     `studies.section3.table_fit`: camera, world and weights of Table 1
``coopmap compare``       `studies.benchmark`: pretrained policies and planners
``coopmap localization``  `studies.localization`
``coopmap bench``         `studies.speed`
``coopmap submit``        `studies.leaderboard`: a policy on a family, with all actions
``coopmap score``         `studies.leaderboard`: replays them, and ranks them on a page
========================  =======================================================================

(``coopmap evaluate`` is no study: it compares policies of your choice; see `coopmap_env.cli`.)
"""

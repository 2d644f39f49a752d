"""Replays: episodes as offline HTML pages with a timeline."""

from coopmap_env.evaluation.replay.page import write_replay
from coopmap_env.evaluation.replay.planar_recording import PlanarFrame, PlanarReplay
from coopmap_env.evaluation.replay.recording import Frame, Replay, record_replay

__all__ = [
    "Frame",
    "PlanarFrame",
    "PlanarReplay",
    "Replay",
    "record_replay",
    "write_replay",
]

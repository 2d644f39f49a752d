"""Arguments of the field environment."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from coopmap_env.envs.arguments import MappingArguments
from coopmap_env.envs.field.settings import FieldSettings
from coopmap_env.robots import Mount
from coopmap_env.simulation.scenes.field import FieldScene

Initialization = Literal["located", "search"]
MotionCorrection = Literal["encoders", "kinematic", "fiducials", "exact"]


@dataclass(frozen=True)
class FieldArguments(MappingArguments):
    """Arguments of `FieldEnv`."""

    mount: str | Mount | Sequence[str | Mount] = "mast"
    """"mast", "husky_panda", "tiago" or a `Mount`; one for all vehicles, or one for each."""
    scene: str | os.PathLike[str] | FieldScene = "worksite"
    """"worksite", "clutter", "rubble", "occluded", a YAML file of meshes and URDFs, or an
    object."""
    initialization: Initialization = "located"
    """Whether robots know their base poses, or have to find the target first, parked with any
    heading (Section 2.2 of the paper)."""
    motion_correction: MotionCorrection = "kinematic"
    """Source of the estimated camera poses: encoders alone, with the suspension assumed at rest;
    kinematics, which predict how far the suspension gives under the mount's weight; kinematics
    corrected by fiducials (Section 2.5); or, for upper bounds only, the true poses."""
    settings: FieldSettings | None = None
    """Camera, noise, map, rating function, motion and physics."""

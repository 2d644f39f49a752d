"""Motion of mounts on suspended vehicles, and their collisions, by PyBullet."""

from coopmap_env.simulation.physics._loading import MAX_VEHICLES
from coopmap_env.simulation.physics.client import BulletClient
from coopmap_env.simulation.physics.kinematic import move_kinematically
from coopmap_env.simulation.physics.stepped import SteppingSettings, move_stepped
from coopmap_env.simulation.physics.world import ArmContact, BulletWorld

__all__ = [
    "MAX_VEHICLES",
    "ArmContact",
    "BulletClient",
    "BulletWorld",
    "SteppingSettings",
    "move_kinematically",
    "move_stepped",
]

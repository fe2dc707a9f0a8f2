"""Plants: what the scheme controls without knowing it."""

from rhl.plants.base import Plant
from rhl.plants.functions import FunctionPlant
from rhl.plants.linear import LinearPlant
from rhl.plants.robot_arm import RobotArm

__all__ = ["FunctionPlant", "LinearPlant", "Plant", "RobotArm"]

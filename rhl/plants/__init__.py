"""Plants: the systems that the scheme controls without a model of them."""

from rhl.plants.base import Plant
from rhl.plants.functions import FunctionPlant
from rhl.plants.linear import LinearPlant
from rhl.plants.robot_arm import RobotArm

__all__ = ["FunctionPlant", "LinearPlant", "Plant", "RobotArm"]

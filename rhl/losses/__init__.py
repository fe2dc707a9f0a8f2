"""Losses c, generators g and the Bregman distance that a generator induces, each with its domain and known properties.

A class marked ``registered`` states everything known about it; a new one needs no entry elsewhere.
"""

from rhl.losses._convex import GENERATORS, LOSSES, Convex, Generator, called, convex, registered
from rhl.losses.custom import CustomLoss, Varying
from rhl.losses.standard import Entropy, LogCosh, PseudoHuber, WeightedSquares, divergence

__all__ = [
    "GENERATORS",
    "LOSSES",
    "Convex",
    "CustomLoss",
    "Entropy",
    "Generator",
    "LogCosh",
    "PseudoHuber",
    "Varying",
    "WeightedSquares",
    "called",
    "convex",
    "divergence",
    "registered",
]

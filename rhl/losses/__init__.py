"""Losses c, generators g and the Bregman distance that a generator induces, each with its domain and its facts.

A class that is marked ``registered`` says everything that is known of it; a new one needs nothing elsewhere.
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

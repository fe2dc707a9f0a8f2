"""Receding horizon learning: the executable companion of Ebenbauer, Pfitz and Yu, arXiv 2010.05891."""

from rhl._checks import InputError

__all__ = ["InputError"]
__version__ = "0.1.0"

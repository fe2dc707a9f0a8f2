"""Receding horizon learning: the executable companion of Ebenbauer, Pfitz and Yu, arXiv 2010.05891."""

from rhl._checks import AssumptionWarning, InputError

__all__ = ["AssumptionWarning", "InputError"]
__version__ = "0.1.0"

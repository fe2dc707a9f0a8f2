"""Comparisons of the scheme with rivals, and campaigns on many plants."""

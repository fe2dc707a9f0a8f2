"""Compiled inner loops over plain arrays, without policy and without errors; imported where something is computed."""

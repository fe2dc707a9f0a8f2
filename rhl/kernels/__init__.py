"""Compiled inner loops over plain arrays, without checks and errors; imported only for computations."""

"""The scheme beside its rivals, on plants that others chose."""

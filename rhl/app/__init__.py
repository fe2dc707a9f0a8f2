"""The command line, its file format, and what it says about a plant and its settings."""

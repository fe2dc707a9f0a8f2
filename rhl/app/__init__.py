"""The command line, its file format, and the diagnosis of a plant and its settings."""

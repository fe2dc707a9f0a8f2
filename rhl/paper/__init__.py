"""The paper: its published curves, its claims as checks, and what the book's pages share."""

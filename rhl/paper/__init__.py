"""The paper: its published curves, its claims as checks, and functions shared by the book's pages."""

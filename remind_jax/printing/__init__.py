"""Words, numbers and tables for the terminal."""

"""Frozen patch features behind one registry; the embedded default needs no weights."""

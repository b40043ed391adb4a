"""Evaluation: HOTA, Identity, CLEAR, recovery."""

"""Who stays undecided: stability, competition, ambiguous and provisional tracks.

Rules: method.md#undecided.
"""

"""Who stays undecided: stability, competition, ambiguous and provisional tracks."""

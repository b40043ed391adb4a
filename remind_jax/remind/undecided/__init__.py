"""Who stays undecided: look-alikes, competition, provisional tracks (method.md#undecided)."""

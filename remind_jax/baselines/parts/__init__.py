"""What baselines are made of."""

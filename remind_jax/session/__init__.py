"""What people call: a run over a whole sequence, and the live tracker of a robot."""

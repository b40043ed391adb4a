"""The tracker of the paper, as pure functions of arrays."""

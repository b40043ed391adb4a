"""What stands for "none" in arrays of whole numbers, the same for all methods."""

NO_ID = -1  # instead of an id
NO_SLOT = -1  # instead of a number by which arrays are read: a slot, a row, a column, a cluster
NEVER = -1  # instead of a frame: that of what did not happen yet

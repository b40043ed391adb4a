"""Linear assignment and k-means: host callbacks and in-graph twins behind one interface."""

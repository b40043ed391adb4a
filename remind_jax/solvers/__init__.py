"""Linear assignment and k-means in the graph."""

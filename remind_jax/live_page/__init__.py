"""A run seen while it goes on, in a browser at a local address."""

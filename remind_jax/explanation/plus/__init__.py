"""Why plus decided as it did."""

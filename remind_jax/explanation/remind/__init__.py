"""Why the paper's tracker decided as it did."""

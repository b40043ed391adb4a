"""What one setting is: its value, what it means, what it may be, and what the original calls it."""

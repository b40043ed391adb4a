"""What is needed of pixel masks, on the host."""

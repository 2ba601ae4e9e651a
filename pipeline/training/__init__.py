"""Training: the examples, the loop, and the search for better recipes."""

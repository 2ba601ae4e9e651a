"""Training: recipes and the loop that turns examples into models."""

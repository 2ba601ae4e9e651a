"""Training: what is learnt from, and the loop that turns it into models."""

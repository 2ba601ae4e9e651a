"""Example transfers (the paper's Figures 1 and 9)."""

"""Experiment 3: warm starts (the paper's Figure 8)."""

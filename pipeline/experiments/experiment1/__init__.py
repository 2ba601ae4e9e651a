"""Experiment 1: ten spacecraft (the paper's Table 2, Figures 2 and 3)."""

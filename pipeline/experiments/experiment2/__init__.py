"""Experiment 2: other swarm sizes (the paper's Figures 4 to 7)."""

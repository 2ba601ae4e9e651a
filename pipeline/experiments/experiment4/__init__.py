"""Experiment 4: other transfer times, which the paper announces without results."""

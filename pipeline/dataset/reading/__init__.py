"""Solved datasets read back: scenarios for the experiments, arrays for training."""

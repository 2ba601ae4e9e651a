"""Experiment 5: plans flown outside the model that they were made in, which the paper has not."""

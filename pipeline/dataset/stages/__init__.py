"""Stages that fill a dataset and check it: sample, solve, verify, repair."""

"""Swarms beyond the paper's largest, n = 30."""

"""Benchmarks of plans, of their cost and of training; `make bench` runs all but `scale`."""

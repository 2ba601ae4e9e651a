"""Planners, which turn scenarios into plans, and their names."""

"""Stages that bring datasets, models and results together: one job a command, no terminal."""

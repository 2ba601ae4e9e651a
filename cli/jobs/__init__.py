"""Jobs that bring datasets, models and results together: one function a command, no terminal."""

"""Jobs of the commands, on datasets, models and results: functions that print nothing."""

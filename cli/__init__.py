"""The command line interface: a function for each command."""

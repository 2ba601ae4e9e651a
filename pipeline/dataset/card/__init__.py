"""The card of a dataset: README.md for its readers, with what dataset hubs read at its head."""

"""The trainings of the networks (the paper's Tables 1 and 3)."""

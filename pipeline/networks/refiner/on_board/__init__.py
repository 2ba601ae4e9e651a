"""The part of a refiner that one craft runs: five steps, between which craft tell each other."""

"""The part of a refiner that one craft runs: six steps, between which craft tell each other."""

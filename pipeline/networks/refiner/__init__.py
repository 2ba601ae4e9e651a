"""The refiner: craft that each solve a program of their own and agree by message passing."""

"""The refiner: craft that each solve a program of their own and bargain over who gives way."""

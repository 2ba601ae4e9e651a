"""The questions that the paper asks, each with a verdict and the numbers that it rests on."""

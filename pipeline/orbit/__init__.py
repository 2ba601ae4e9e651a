"""Relative orbital mechanics of a swarm: pure functions on arrays, SI units, LVLH frame."""

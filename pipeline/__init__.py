"""The science and the stages of prolearn: orbits, scenarios, expert, networks, experiments."""

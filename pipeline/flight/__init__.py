"""What becomes of a plan when it is flown: other dynamics, errors, replanning."""

"""Plans flown in other dynamics than those they are made for, with errors and replanning."""

# Names of the ways to fly a plan
OPEN, FEEDBACK, REPLANNED, MARGIN = "open loop", "feedback", "replanned", "with margin"

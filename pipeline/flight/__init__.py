"""Plans flown in other dynamics than those they are made for, with errors and replanning."""

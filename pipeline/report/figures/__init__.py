"""The report's figures, and how planners look in them."""

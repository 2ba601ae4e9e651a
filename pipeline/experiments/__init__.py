"""The paper's experiments: every planner on the same scenarios, judged by the same measures."""

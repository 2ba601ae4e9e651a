"""Networks: the paper's six architectures, the protocol they share, and trained models."""

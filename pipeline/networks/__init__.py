"""Networks: the protocol of architectures, the paper's six, their recipes, and trained models."""

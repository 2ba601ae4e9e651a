"""Ablations: what each idea of the refiner is worth, beside the rule that it began with."""

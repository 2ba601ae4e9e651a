"""What the folder of a dataset holds: its layout, manifest, samples, schema and columns."""

"""Datasets: scenarios and the expert's plans for them in Parquet shards."""

"""The registry: runs, registered models and results in MLflow; no other package imports mlflow.

Every function that opens the tracking store raises ``ProlearnError`` where the store fails.
"""

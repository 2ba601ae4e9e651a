"""What MLflow knows: runs, models, versions; the only package that imports mlflow."""

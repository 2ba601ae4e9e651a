"""What a tracking store holds, without what differs from run to run."""

import hashlib
import shutil
from pathlib import Path
from typing import Any
from uuid import uuid4

import pandas as pd

VARYING = ("seconds", "time", "run", "created")
"""Parts of the names of columns and parameters that differ from run to run."""


def facts(folder: Path) -> dict[str, Any]:
    """Finished runs with their tables, registered versions with their weights, champions.

    A run that does not say how it ended is a fact too.
    """
    import mlflow

    # MLflow keeps connections open: to a file of this name that has been replaced since.
    database = folder.parent / f"{uuid4().hex}.db"
    shutil.copyfile(folder / "mlflow.db", database)
    client = mlflow.MlflowClient(tracking_uri=f"sqlite:///{database}")
    names = {e.experiment_id: e.name for e in client.search_experiments()}
    runs = client.search_runs(list(names), max_results=1000)
    finished = [
        (names[run.info.experiment_id], run.info.run_name, _table(folder, run))
        for run in runs
        if run.info.status == "FINISHED"
    ]
    versions = client.search_model_versions()
    weights = {(v.name, v.version): _weights(folder, v.source) for v in versions}
    champions = {
        model.name: weights[model.name, model.aliases["champion"]]
        for model in client.search_registered_models()
        if "champion" in model.aliases
    }
    return {
        "finished": sorted(set(finished)),
        "running": sum(run.info.status == "RUNNING" for run in runs),
        "networks": sorted(set(weights.values())),
        "champions": champions,
    }


def _table(folder: Path, run: Any) -> str:
    found = list(folder.glob(f"mlruns/*/{run.info.run_id}/artifacts/tables/table.parquet"))
    if not found:
        return ""
    table = pd.read_parquet(found[0])
    kept = [name for name in table.columns if not any(word in name for word in VARYING)]
    return table[kept].to_csv()


def _weights(folder: Path, source: str) -> str:
    model = source.rpartition("/")[2]
    (found,) = folder.glob(f"mlruns/*/models/{model}/artifacts/data/network/weights.safetensors")
    return hashlib.sha256(found.read_bytes()).hexdigest()

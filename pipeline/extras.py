"""Packages that a light installation leaves out, and which extra brings each."""

from collections.abc import Iterator
from contextlib import contextmanager

from pipeline.errors import InputError

EXTRAS = {
    "refiner": ("numba", "safetensors"),
    "onnx": ("onnx", "onnxruntime", "onnxscript"),
    "tune": ("optuna",),
    "dask": ("dask", "distributed"),
    "learn": (
        *("filelock", "fsspec", "joblib", "markdown_it", "mlflow", "pandas", "pyarrow"),
        *("sqlalchemy", "tabulate", "threadpoolctl", "torch", "yaml"),
    ),
}
"""Names to import by, of each extra; ``learn`` has those of ``refiner`` as well."""


def missing(error: ModuleNotFoundError) -> InputError | None:
    """What to do about a package that is not there, or None where no extra has it."""
    package = (error.name or "").partition(".")[0]
    for extra, packages in EXTRAS.items():
        if package in packages:
            return InputError(
                f"this needs {package}, which is not installed; expected the extra `{extra}`: "
                f"pip install 'prolearn[{extra}]'."
            )
    return None


@contextmanager
def told_which_extra() -> Iterator[None]:
    """In the block a package that no light installation has is an InputError with its extra."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (said := missing(error)) is None:
            raise
        raise said from error

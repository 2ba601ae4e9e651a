"""What all tests share."""

import os

# Arrays and networks this small are slower on several threads, above all beside other workers.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")

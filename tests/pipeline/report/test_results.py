"""What a report refuses to be made from."""

import pandas as pd
import pytest

from pipeline.errors import InputError
from pipeline.report import Results


def test_results_without_trials_or_columns_are_refused_with_what_to_do(trials):
    with pytest.raises(InputError, match="prolearn evaluate"):
        Results(trials.head(0))
    with pytest.raises(InputError, match="'trials' lacks the columns fuel, seconds"):
        Results(trials.drop(columns=["seconds", "fuel"]))
    with pytest.raises(InputError, match="'curves' lacks"):
        Results(trials, curves=pd.DataFrame({"arch": ["ff1"]}))

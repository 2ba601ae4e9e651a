import os

import pytest

CODE = """
import sys
for name in [*sys.modules]:
    if name.startswith("pipeline.networks.refiner"):
        del sys.modules[name]  # to be imported anew
import numpy as np
from numba.core import caching, config
config.CACHE_DIR = ""  # whatever NUMBA_CACHE_DIR is
caching.CacheImpl._locator_classes = [caching.UserProvidedCacheLocator]  # no other is writable
from pipeline.networks.refiner.geometry import Sides
print(Sides.of(np.array([[4, 7]])).aggregate(np.ones((1, 2, 3)), np.ones((1, 2))).shape)
"""


@pytest.mark.parametrize("mode", [0o700, 0o777])
def test_without_a_place_of_numbas_code_is_kept_in_a_temporary_folder_only_this_user_writes_to(
    tmp_path, mode, forked
):
    folder = tmp_path / f"prolearn-numba-{os.getuid()}"
    folder.mkdir()
    folder.chmod(mode)
    given = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA")}
    done = forked.run((), tmp_path, {**given, "TMPDIR": str(tmp_path)}, code=CODE)
    assert (done.returncode, done.stdout) == (0, "(1, 2, 6)\n"), done.stderr
    assert bool([*folder.rglob("*.nbc")]) == (mode == 0o700)

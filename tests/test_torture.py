"""A short form of `make torture`: kills, full disks and damaged files, and nothing is lost."""

import pytest
from torture.__main__ import torture

pytestmark = pytest.mark.system


@pytest.mark.timeout(900)
def test_kills_and_damaged_files_lose_nothing_and_go_by_in_silence_nowhere(
    tmp_path, forked, migrated
):
    tally = torture(tmp_path, forked, seed=0, kills=2, flips=4, store=migrated)
    assert tally.bad == 0, "\n".join(tally.stories)

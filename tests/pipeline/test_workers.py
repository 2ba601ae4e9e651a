import os

import pytest

from pipeline.parallel.workers import Workers


def process(task, content):
    """Where a task was done."""
    return os.getpid()


@pytest.mark.parametrize(("tasks", "here"), [(1, True), (2, False)])
def test_a_task_alone_is_done_without_another_process(tasks, here):
    done = dict(Workers(2).work(process, range(tasks), lambda task: b""))
    assert done.keys() == set(range(tasks))
    assert (set(done.values()) == {os.getpid()}) == here

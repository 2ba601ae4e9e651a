"""A worker process of this machine ends with the process that started it.

loky calls this first in a worker, before it takes any work, so it must import fast.
"""

import os
import threading
import time

LOOK_SECONDS = 0.5
"""How often a worker looks whether its parent is still there."""


def end_with(parent: int) -> None:
    """End this process when its parent has ended, even by a kill that let it tell nobody.

    Args:
        parent: its process id; the parent may have ended before this is called.
    """
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(LOOK_SECONDS)
    os._exit(1)

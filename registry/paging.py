"""Searches of MLflow whose results come in pages."""

from collections.abc import Callable, Iterator
from typing import Any


def pages(search: Callable[..., Any], **query: Any) -> Iterator[Any]:
    """All results of one of MLflow's searches, page after page."""
    token = None
    while True:
        page = search(page_token=token, **query)
        yield from page
        token = page.token
        if not token:
            return

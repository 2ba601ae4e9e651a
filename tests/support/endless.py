"""A planner that never answers."""


def endless(*_: object) -> None:
    while True:
        pass

"""Earlier name of ``registry.pyfunc``, by which models registered by earlier versions load."""

from registry.pyfunc import _load_pyfunc

__all__ = ["_load_pyfunc"]

"""The loader module that models registered by earlier versions name: now ``registry.pyfunc``."""

from registry.pyfunc import _load_pyfunc

__all__ = ["_load_pyfunc"]

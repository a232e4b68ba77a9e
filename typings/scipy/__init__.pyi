"""Only what is needed is typed; the rest is not checked."""

from typing import Any

def __getattr__(name: str) -> Any: ...

# The compiled package ships no types; its names are taken as they are.
from typing import Any

def __getattr__(name: str) -> Any: ...

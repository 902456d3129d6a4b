# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's classes are compiled and ship no types: to the type checker, every name exists and may be anything."""

from typing import Any

def __getattr__(name: str) -> Any: ...

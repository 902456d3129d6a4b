# SPDX-License-Identifier: Apache-2.0
"""Makes what a plan names: finds the class or function, checks the options against its signature, calls it."""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from trueup.errors import ParameterError, PlanError, TrueupError, unknown_name
from trueup.extensions import addressed, registered
from trueup.typed_toml import Component, check_keys, converted

_OWN = frozenset(["seed", "folder"])
"""What a plan may say otherwise of all that its parts are given: the rest is not to be written in a file."""


def instance(component: Component, kind: str, known: Mapping[str, str], given: Mapping[str, Any], base: Path) -> Any:
    """What `component` names, called with its options.

    `known` holds short names as 'module:attribute'; other packages add theirs by the entry points 'trueup.<kind>s'. The
    callable also gets what it asks for by name out of `given`; of that a plan may say a seed or a folder otherwise. Paths are
    relative to `base`. Raises PlanError, which names file, table, key, value and the choices.
    """
    target = component_type(component, kind, known, base)
    return called(component, target, given, base)


def component_type(component: Component, kind: str, known: Mapping[str, str], base: Path) -> Callable[..., Any]:
    """The class or function that `component` names. Raises PlanError."""
    address = component.type
    if ":" not in address:
        names = {**registered(f"trueup.{kind}s"), **known}
        if address not in names:
            error = unknown_name(kind, address, names, "what trueup knows")
            raise PlanError(f'{component.where}: {error}; or name your own as "module:attribute"')
        address = names[address]
    target = addressed(address, base, lambda text: PlanError(f"{component.where}: {text}"))
    if not callable(target):
        raise PlanError(f"{component.where}: '{address}' is a {type(target).__name__}, not a class or function")
    return target


def called(component: Component, target: Callable[..., Any], given: Mapping[str, Any], base: Path) -> Any:
    """`target` called with the component's options and what it asks for out of `given`.

    Raises PlanError, and what `target` raises; a ParameterError names file and table too.
    """
    try:
        return target(**arguments(component, target, given, base))
    except ParameterError as error:  # of a name or a value among its options: such an error does not know the plan
        raise type(error)(f"{component.where}: {error}") from error
    except TrueupError:
        raise
    except (TypeError, ValueError) as error:
        raise PlanError(f"{component.where}: '{component.type}' cannot be made: {error}") from error


def arguments(component: Component, target: Callable[..., Any], given: Mapping[str, Any], base: Path) -> dict[str, Any]:
    """What `target` is to be called with: the component's options, checked, and what it asks for out of `given`.

    Raises PlanError for an option that it does not take or of a wrong type, and for one that is missing.
    """
    parameters = inspect.signature(target).parameters
    names = [n for n, p in parameters.items() if p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
    writable = [n for n in names if n not in given or n in _OWN]
    if not any(p.kind is p.VAR_KEYWORD for p in parameters.values()):
        check_keys(component.options, writable, component.where)
    hints = _hints(target)
    options = {k: _option(hints.get(k, Any), v, component.where, k, base) for k, v in component.options.items()}
    offered = {k: v for k, v in given.items() if k in names}
    for name in names:
        if parameters[name].default is inspect.Parameter.empty and name not in options and name not in offered:
            raise PlanError(f"{component.where}: '{component.type}' needs '{name}'; it takes: {', '.join(writable)}")
    return {**offered, **options}


def _hints(target: Callable[..., Any]) -> dict[str, Any]:
    """The annotations of the parameters of what is called; without those that cannot be resolved."""
    function: Any = target.__init__ if inspect.isclass(target) else getattr(target, "func", target)  # of a partial
    names = getattr(inspect.unwrap(function), "__globals__", {})
    found: dict[str, Any] = {}
    for name, annotation in getattr(function, "__annotations__", {}).items():
        if name == "return":
            continue
        alone = type("Alone", (), {"__annotations__": {name: annotation}})
        try:
            found[name] = typing.get_type_hints(alone, globalns=names)[name]
        except (NameError, TypeError, AttributeError):
            continue
    return found


def _option(hint: Any, value: Any, where: str, key: str, base: Path) -> Any:
    made_of = converted(hint, value, where, key)
    choices = typing.get_args(hint) if typing.get_origin(hint) in (typing.Union, types.UnionType) else (hint,)
    if Path in choices and isinstance(made_of, (str, Path)):
        return base / made_of
    if any(typing.get_args(c)[:1] == (Path,) for c in choices) and isinstance(made_of, tuple):
        return tuple(base / entry for entry in made_of)
    return made_of

"""Reads from the fields of a value at which ages its times matter, as `fsai_vcu/core/ages.py` declares it."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from msgspec import Struct

from fsai_hil.rules.numbers import CYCLE_NS
from fsai_vcu.core.ages import Ages, NoAge, NotSearched, Within

Declaration = Ages | NoAge | NotSearched | Within


def declared(
    made: type[Struct], given: Mapping[str, Declaration] = MappingProxyType({})
) -> dict[str, Declaration | None]:
    """Each field's declaration; those `given` come before the fields' own.

    Raises ValueError, which names the file to change, if a time has none.
    """
    hints = get_type_hints(made, include_extras=True)
    if unknown := given.keys() - hints.keys():
        raise ValueError(f"{made.__name__} has no {', '.join(sorted(unknown))}")
    found: dict[str, Declaration | None] = {}
    for name in made.__struct_fields__:
        notes = get_args(hints[name])[1:] if get_origin(hints[name]) is Annotated else ()
        own = next((note for note in notes if isinstance(note, (Ages, NoAge, NotSearched, Within))), None)
        found[name] = given.get(name, own)
        if found[name] is None and name.endswith("_ns"):
            raise ValueError(
                f"{inspect.getsourcefile(made)}: {made.__name__}.{name} is a time and does not say at which ages "
                "it matters: declare it Annotated[..., Ages(...)], see fsai_vcu/core/ages.py"
            )
    return found


def edges_ns(ages: Ages, config: Any = None) -> tuple[int, ...]:
    """The ages in ns; names are those of `config`.

    A gap that is noticed when a frame comes matters a cycle earlier too.
    """

    def ns(age: str | int) -> int:
        return age if isinstance(age, int) else sum(getattr(config, name) for name in age.split(" + "))

    return (*map(ns, ages.at), *map(ns, ages.gap), *(ns(gap) - CYCLE_NS for gap in ages.gap))


def all_edges_ns(made: type[Struct]) -> tuple[tuple[int, ...], ...]:
    """Return the ages of each time of a value, in the order of its fields.

    Raises ValueError, which names the file to change, if a time has no declaration.
    """
    return tuple(edges_ns(note) for note in declared(made).values() if isinstance(note, Ages))

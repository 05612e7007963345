"""The mistakes: every place of a module at which a small one can be made, and what stands there then.

A mutant puts one other node into the module's syntax tree. Annotations, docstrings and `assert` are left alone: the
first two do nothing, the third only tells the type checker.
"""

from __future__ import annotations

import ast
import copy
import enum
import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from types import CodeType
from typing import Any, Final

from fsai_vcu.interface.values import Value

Key = tuple[str, str, str, int]
"""A mutant's name, which stays the same when lines above it come and go: the module's last name with the function or
class, the code there, the code that takes its place, and its number among those alike in the same function or class."""

Mistake = tuple[str, ast.AST]  # its kind, and what stands in the node's place then

# A mistake that every test notices which notices another one is not made: `>=` for `<` gives what a forced condition
# gives, `or` for `and` what a dropped one gives, and `max` for `min` what a dropped bound gives.
_OTHER: Final[Mapping[type[ast.AST], type[Any]]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Add: ast.Sub, ast.Sub: ast.Add,
    ast.Mult: ast.Div, ast.Div: ast.Mult, ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr,
}  # fmt: skip
_OTHER_CALL: Final = {"any": "all", "all": "any", "sorted": "list", "floor": "ceil", "trunc": "ceil"}
_LEFT_ALONE: Final = (ast.Import, ast.ImportFrom, ast.Assert)
_FIELDS_LEFT_ALONE: Final = {"annotation", "target", "targets", "returns", "decorator_list", "bases", "args"}
_SHOWN: Final = 180  # characters


class Mutant(Value, frozen=True):
    """One mistake in one module."""

    module: str  # dotted
    key: Key
    operator: str
    lines: range  # of the statement around it
    tree: ast.Module
    holder: Any  # the list, or the fields of the node, in which the mistake stands
    place: int | str
    node: ast.AST

    def code(self, path: str) -> CodeType:
        """The module with the mistake in it."""
        before, self.holder[self.place] = self.holder[self.place], self.node
        try:
            return compile(ast.fix_missing_locations(self.tree), path, "exec")
        finally:
            self.holder[self.place] = before


def _children(node: Any) -> Iterator[tuple[str, Any, int | str, Any]]:
    """Yield what may be mistaken below it: each with its field and place. A function's defaults come first."""
    if isinstance(node, ast.FunctionDef):
        yield from (child for child in _children(node.args) if child[0] in ("defaults", "kw_defaults"))
    alone = _FIELDS_LEFT_ALONE - {"args"} if isinstance(node, ast.Call) else _FIELDS_LEFT_ALONE
    for field, value in () if isinstance(node, ast.JoinedStr) else ast.iter_fields(node):
        places = enumerate(value) if isinstance(value, list) else [(field, value)]
        holder = value if isinstance(value, list) else vars(node)
        yield from ((field, holder, at, one) for at, one in places if field not in alone and isinstance(one, ast.AST))


def _text(statement: ast.AST) -> str:
    """Return a statement as Python writes it; of one that has a body, the head."""
    blocks = ("body", "orelse", "finalbody", "handlers", "decorator_list")
    return ast.unparse(_with(statement, **{name: [] for name in blocks if hasattr(statement, name)}))


def _about(minus: str, plus: str) -> tuple[str, str]:
    """Return what stands about the first difference of two long texts."""
    differ = (place for place, (old, new) in enumerate(zip(minus, plus, strict=False)) if old != new)
    first = max(0, next(differ, 0) - _SHOWN // 3) if len(minus) > _SHOWN else 0
    return minus[first : first + _SHOWN], plus[first : first + _SHOWN]


class Walk:
    """One pass over a module's tree. `namespace`: the imported module's names."""

    def __init__(self, module: str, source: str, namespace: Mapping[str, Any]) -> None:
        self._module = module
        self._tree = ast.parse(source)
        self._namespace = namespace
        words = (node.value for node in ast.walk(self._tree) if isinstance(node, ast.Constant))
        self._names = sorted({word for word in words if isinstance(word, str) and word.isidentifier()})
        self._place = module.rpartition(".")[2]
        self._function: ast.FunctionDef | None = None
        self._statement: Any = None
        self._seen: set[tuple[ast.AST, str]] = set()
        self._keys: Counter[tuple[str, str, str]] = Counter()

    def mutants(self, node: Any = None) -> Iterator[Mutant]:
        """Every mutant of the module, or of what is below `node`, in the order of the text."""
        for field, holder, place, child in _children(node or self._tree):
            words = isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)
            if words or isinstance(child, _LEFT_ALONE):
                continue
            outer = self._statement, self._place, self._function
            if isinstance(child, ast.stmt):
                self._statement = child
            if field == "body" and isinstance(node, ast.FunctionDef | ast.ClassDef):
                self._place = f"{self._place}.{node.name}"
                self._function = node if isinstance(node, ast.FunctionDef) else None
            for operator, instead in self._mistakes(child, node, field):
                yield from self._made(operator, holder, place, instead)
            yield from self.mutants(child)
            self._statement, self._place, self._function = outer

    def _made(self, operator: str, holder: Any, place: int | str, instead: ast.AST) -> Iterator[Mutant]:
        statement, node = self._statement, holder[place]
        minus = _text(statement)
        holder[place] = instead
        plus = _text(instead if statement is node else statement)
        holder[place] = node
        if plus == minus or (statement, plus) in self._seen:
            return
        self._seen.add((statement, plus))
        words = self._place, *_about(minus, plus)
        self._keys[words] += 1
        key, lines = (*words, self._keys[words]), range(statement.lineno, statement.end_lineno + 1)
        yield Mutant(self._module, key, operator, lines, self._tree, holder, place, instead)

    # ------------------------------------------------------------ mistakes

    def _mistakes(self, node: Any, parent: Any, field: str) -> Iterator[Mistake]:
        """Yield the mistakes that a person could make at a node, by kind."""
        returns = ast.unparse(self._function.returns) if self._function and self._function.returns else ""
        returned = isinstance(parent, ast.Return)
        condition = isinstance(node, ast.Compare | ast.BoolOp) or (returned and returns == "bool")
        if condition or field in ("test", "ifs", "guard") or isinstance(getattr(node, "op", None), ast.Not):
            yield from (("condition forced", ast.Constant(value)) for value in (True, False))
        elif isinstance(parent, ast.BoolOp) and field == "values":
            yield "condition dropped", ast.Constant(isinstance(parent.op, ast.And))
        if returned and returns.endswith("| None"):
            yield "nothing returned", ast.Constant(None)
        match node:
            case ast.Return(value=None) | ast.Raise() | ast.Expr():
                yield "statement removed", ast.Pass()
            case ast.Assign() | ast.AugAssign() | ast.AnnAssign(value=ast.expr()) if self._function:
                yield "statement removed", ast.Pass()
            case ast.cmpop() | ast.operator() if type(node) in _OTHER:
                yield "operator", _OTHER[type(node)]()
            case ast.UnaryOp(op=ast.USub()):
                yield "sign", node.operand
            case ast.Constant(value=value):
                yield from self._constant(value)
            case ast.JoinedStr():
                yield "words removed", ast.Constant("")
            case ast.Attribute(value=ast.Name(id=owner), attr=name):
                yield from _member(node, self._namespace.get(owner), name)
            case ast.Call():
                yield from _call(node)
            case ast.Tuple(elts=parts) | ast.List(elts=parts) | ast.Set(elts=parts):
                for place in range(0 if isinstance(parent, ast.Subscript) else len(parts)):  # there it is a type
                    yield "element dropped", _with(node, elts=_without(parts, place))
            case ast.Dict(keys=keys, values=values):
                for place in range(len(keys)):
                    yield "entry dropped", _with(node, keys=_without(keys, place), values=_without(values, place))

    def _constant(self, value: Any) -> Iterator[Mistake]:
        others: list[Any] = []
        match value:
            case bool():
                others = [not value]
            case int():
                others = [value + 1, value - 1]
            case float():
                others = [value + 1.0, -value if value else -1.0]
            case str() if value in self._names and len(self._names) > 1:
                others = [self._names[(self._names.index(value) + 1) % len(self._names)]]
            case str():
                others = ["" if value else "words"]
        yield from (("words" if isinstance(value, str) else "constant", ast.Constant(other)) for other in others)


def _member(node: ast.Attribute, owner: Any, name: str) -> Iterator[Mistake]:
    if owner is math and name == "inf":
        yield "sign", ast.UnaryOp(ast.USub(), node)
    if isinstance(owner, enum.EnumMeta) and name in owner.__members__:
        members = list(owner.__members__)
        for step in (1, -1):
            yield "another member", _with(node, attr=members[(members.index(name) + step) % len(members)])


def _call(node: ast.Call) -> Iterator[Mistake]:
    """Yield the mistakes in a call: another function, another argument, one left out."""
    attribute = "id" if isinstance(node.func, ast.Name) else "attr"
    name = getattr(node.func, attribute, "")
    args = node.args
    if name in _OTHER_CALL:
        yield "another function", _with(node, func=_with(node.func, **{attribute: _OTHER_CALL[name]}))
    if name in ("min", "max") and len(args) > 1:
        for place in range(len(args)):
            rest = _without(args, place)
            yield "bound dropped", _with(node, args=rest) if len(rest) > 1 else rest[0]
    if name == "abs":
        yield "abs dropped", args[0]
    if name[:1].isupper() or name == "replace":
        for place in range(len(node.keywords)):
            yield "field dropped", _with(node, keywords=_without(node.keywords, place))
        for first, second in itertools.pairwise(range(len(args))):
            swapped = [*args[:first], args[second], args[first], *args[second + 1 :]]
            yield "arguments swapped", _with(node, args=swapped)


def _with(node: Any, **fields: object) -> Any:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _without(parts: Sequence[Any], place: int) -> list[Any]:
    return [*parts[:place], *parts[place + 1 :]]

"""The mistakes: every place of a module at which a small one can be made, and what stands there then.

A mutant replaces one span of the source text, so that it can be shown as a difference of lines a person can read.
Annotations, docstrings and `assert` are left alone: the first two do nothing, the third only tells the type checker.
"""

from __future__ import annotations

import ast
import copy
import enum
import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

Key = tuple[str, str, str, int]

# A mistake that every test notices which notices another one is not made: `>=` for `<` gives what a forced condition
# gives, `or` for `and` what a dropped one gives, and `max` for `min` what a dropped bound gives.
_AT_THE_EDGE: Final = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
_OTHER: Final[Mapping[type[ast.AST], type[Any]]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
}  # fmt: skip
_OTHER_CALL: Final = {"any": "all", "all": "any", "sorted": "list", "floor": "ceil", "trunc": "ceil"}
_LEFT_ALONE: Final = (ast.Import, ast.ImportFrom, ast.Assert, ast.arguments)
_FIELDS_LEFT_ALONE: Final = {"annotation", "target", "targets"}
_OF_FIXED_LENGTH: Final = (ast.Return, ast.Subscript, ast.Tuple, ast.List, ast.Set, ast.DictComp)
_BINDS_LOOSELY: Final = (ast.BoolOp, ast.BinOp, ast.Compare, ast.IfExp, ast.UnaryOp, ast.Lambda)
_BINDS: Final = (*_BINDS_LOOSELY, ast.Attribute, ast.Subscript, ast.Starred)


@dataclass(frozen=True, slots=True)
class Mutant:
    """One mistake in one module."""

    module: str  # dotted
    where: str  # the function or class it is in, "" at the top
    operator: str
    start: int  # the span of bytes that is replaced
    end: int
    text: str
    lines: tuple[int, int]  # of the statement around it
    at_import: bool  # it acts when the module is imported, not when a function is called
    minus: str = ""  # the lines that change: as they are, and as they are then
    plus: str = ""
    nth: int = 1  # of the mutants with the same words in the same place

    @property
    def place(self) -> str:
        stem = self.module.rpartition(".")[2]
        return f"{stem}.{self.where}" if self.where else stem

    @property
    def key(self) -> Key:
        """What stays the same when lines above it come and go."""
        return self.place, self.minus, self.plus, self.nth


def mutated(source: str, mutant: Mutant) -> str:
    """The module's text with the mistake in it."""
    text = source.encode()
    return (text[: mutant.start] + mutant.text.encode() + text[mutant.end :]).decode()


def mutants_of(module: str, source: str, namespace: Mapping[str, Any]) -> list[Mutant]:
    """Every mutant of a module, in the order of its text. `namespace`: the imported module's names."""
    seen = {source}
    names: Counter[Key] = Counter()
    found = []
    for mutant in sorted(_Walk(module, source, namespace).mutants(), key=lambda m: (m.start, m.end, m.text)):
        text = mutated(source, mutant)
        if text in seen:
            continue
        seen.add(text)
        minus, plus = _difference(source, mutant)
        one = replace(mutant, minus=minus, plus=plus)
        names[one.key] += 1
        found.append(replace(one, nth=names[one.key]))
    return found


def _difference(source: str, mutant: Mutant) -> tuple[str, str]:
    text = source.encode()
    first, last = text.rfind(b"\n", 0, mutant.start) + 1, text.find(b"\n", mutant.end)
    old = text[first:last].decode().splitlines()
    new = (text[first : mutant.start] + mutant.text.encode() + text[mutant.end : last]).decode().splitlines()
    while len(old) > 1 and new and old[-1] == new[-1]:
        del old[-1], new[-1]
    while len(old) > 1 and new and old[0] == new[0]:
        del old[0], new[0]
    return "\n".join(line.strip() for line in old), "\n".join(line.strip() for line in new if line.strip())


class _Walk:
    """One pass over a module's tree."""

    def __init__(self, module: str, source: str, namespace: Mapping[str, Any]) -> None:
        self._module = module
        self._source = source.encode()
        self._starts = [0]
        for line in self._source.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))
        self._tree = ast.parse(source)
        self._namespace = namespace
        words = (node.value for node in ast.walk(self._tree) if isinstance(node, ast.Constant))
        self._names = sorted({word for word in words if isinstance(word, str) and word.isidentifier()})
        self._where: tuple[str, ...] = ()
        self._function: ast.FunctionDef | None = None
        self._lines = (1, 1)

    def mutants(self) -> Iterator[Mutant]:
        for statement in self._tree.body:
            yield from self._walk(statement, self._tree)

    def _walk(self, node: ast.AST, parent: ast.AST) -> Iterator[Mutant]:
        if isinstance(node, _LEFT_ALONE) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            return
        outer = self._lines, self._where, self._function
        if isinstance(node, ast.stmt):
            head = getattr(node, "test", None) or getattr(node, "iter", None) or node
            block = (head is node and hasattr(node, "body")) or isinstance(node, ast.Match)
            self._lines = node.lineno, node.lineno if block else head.end_lineno or node.lineno
        yield from self._mistakes(node, parent)
        children = [
            child
            for name, value in ast.iter_fields(node)
            if name not in _FIELDS_LEFT_ALONE
            for child in (value if isinstance(value, list) else [value])
            if isinstance(child, ast.AST)
        ]
        if isinstance(node, ast.FunctionDef):
            for default in filter(None, (*node.args.defaults, *node.args.kw_defaults)):
                yield from self._walk(default, node)
            self._function = node
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            self._where, children = (*self._where, node.name), [*node.body]
        elif isinstance(node, ast.JoinedStr):
            children = []  # positions inside differ between Python's versions
        for child in children:
            yield from self._walk(child, node)
        self._lines, self._where, self._function = outer

    def _has_value(self, names: set[str], line: int) -> bool:
        """Whether a statement of this line may be missing: the names it binds are arguments, or bound above it."""
        if self._function is None:
            return False
        bound = {each.arg for each in ast.walk(self._function) if isinstance(each, ast.arg)}
        for statement in ast.walk(self._function):
            if isinstance(statement, ast.Name) and statement.lineno < line:
                bound |= _names(statement)
        return names <= bound

    # ------------------------------------------------------------ text

    def _span(self, node: Any) -> tuple[int, int]:
        begin = self._starts[node.lineno - 1] + node.col_offset
        return begin, self._starts[node.end_lineno - 1] + node.end_col_offset

    def _whole(self, node: Any) -> tuple[int, int]:
        """The span of one of several parts, with the parentheses around it."""
        begin, end = self._span(node)
        while True:
            before, after = self._source[:begin].rstrip(), self._source[end:].lstrip()
            if not (before.endswith(b"(") and after.startswith(b")")):
                return begin, end
            begin, end = len(before) - 1, len(self._source) - len(after) + 1

    def _made(self, operator: str, start: int, end: int, text: str) -> Mutant:
        at_import = self._function is None
        return Mutant(self._module, ".".join(self._where), operator, start, end, text, self._lines, at_import)

    def _instead(self, operator: str, node: ast.AST, new: ast.AST | str, parent: ast.AST | None = None) -> Mutant:
        text = new if isinstance(new, str) else ast.unparse(new)
        same = isinstance(node, ast.Compare) and isinstance(new, ast.Compare)
        loose = isinstance(new, _BINDS_LOOSELY) and isinstance(parent, _BINDS) and not same
        if loose and self._whole(node) == self._span(node):
            text = f"({text})"
        return self._made(operator, *self._span(node), text)

    def _without(self, operator: str, parts: Sequence[tuple[int, int]], place: int) -> Mutant:
        """One of several parts less, with its comma."""
        if place + 1 < len(parts):
            return self._made(operator, parts[place][0], parts[place + 1][0], "")
        return self._made(operator, parts[place - 1][1] if place else parts[0][0], parts[place][1], "")

    # ------------------------------------------------------------ mistakes

    def _mistakes(self, node: Any, parent: ast.AST) -> Iterator[Mutant]:
        match node:
            case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test):
                yield from self._forced(test)
            case ast.comprehension(ifs=tests):
                for test in tests:
                    yield from self._forced(test)
            case ast.match_case(guard=ast.expr() as guard):
                yield from self._forced(guard)
            case ast.Return(value=ast.expr() as value):
                returns = ast.unparse(self._function.returns) if self._function and self._function.returns else ""
                if returns == "bool":
                    yield from self._forced(value)
                elif returns.endswith("| None") and not _is_constant(value, None):
                    yield self._instead("nothing returned", value, "None")
            case ast.Return() | ast.Raise() | ast.Expr():
                yield self._instead("statement removed", node, "pass")
            case ast.Assign() | ast.AugAssign() | ast.AnnAssign():
                names = set().union(*map(_names, node.targets if isinstance(node, ast.Assign) else [node.target]))
                if self._has_value(names, node.lineno):
                    yield self._instead("statement removed", node, "pass")
                if isinstance(node, ast.AugAssign):
                    yield self._instead("arithmetic", node, _with(node, op=_OTHER[type(node.op)]()))
            case ast.Compare(ops=signs):
                yield from self._forced(node)
                for place, sign in enumerate(signs):
                    if type(sign) in _AT_THE_EDGE:
                        other = _AT_THE_EDGE[type(sign)]()
                        changed = _with(node, ops=[*signs[:place], other, *signs[place + 1 :]])
                        yield self._instead("comparison", node, changed, parent)
            case ast.BoolOp(op=op, values=values):
                yield from self._forced(node)
                for value in values:
                    yield self._instead("condition dropped", value, str(isinstance(op, ast.And)))
            case ast.UnaryOp(op=ast.Not()):
                yield from self._forced(node)
            case ast.UnaryOp(op=ast.USub()):
                yield self._instead("sign", node, node.operand, parent)
            case ast.BinOp(op=op) if type(op) in _OTHER:
                if not any(isinstance(side, ast.JoinedStr) or _is_words(side) for side in (node.left, node.right)):
                    yield self._instead("arithmetic", node, _with(node, op=_OTHER[type(op)]()), parent)
            case ast.Constant(value=value):
                yield from self._constant(node, value)
            case ast.JoinedStr():
                yield self._instead("words removed", node, '""')
            case ast.Attribute(value=ast.Name(id=owner), attr=name):
                yield from self._member(node, self._namespace.get(owner), name)
            case ast.Call():
                yield from self._call(node)
            case ast.Tuple() | ast.List() | ast.Set():
                yield from self._display(node, parent)
            case ast.Dict(keys=keys, values=values):
                begins = [
                    self._span(v)[0] - 2 if k is None else self._whole(k)[0] for k, v in zip(keys, values, strict=True)
                ]
                entries = [(begin, self._whole(value)[1]) for begin, value in zip(begins, values, strict=True)]
                for place in range(len(entries)):
                    yield self._without("entry dropped", entries, place)

    def _forced(self, node: ast.expr) -> Iterator[Mutant]:
        for value in (True, False):
            if not _is_constant(node, value):
                yield self._instead("condition forced", node, str(value))

    def _constant(self, node: ast.Constant, value: object) -> Iterator[Mutant]:
        match value:
            case bool():
                yield self._instead("constant", node, str(not value))
            case int():
                yield self._instead("constant", node, str(value + 1))
                yield self._instead("constant", node, str(value - 1))
            case float():
                yield self._instead("constant", node, repr(value + 1.0))
                yield self._instead("constant", node, repr(-value if value else -1.0))
            case str() if value in self._names and len(self._names) > 1:
                other = self._names[(self._names.index(value) + 1) % len(self._names)]
                yield self._instead("another name", node, f'"{other}"')
            case str():
                yield self._instead("words removed", node, '""' if value else '"words"')

    def _member(self, node: ast.Attribute, owner: Any, name: str) -> Iterator[Mutant]:
        if owner is math and name == "inf":
            yield self._instead("sign", node, "-math.inf")
        if isinstance(owner, enum.EnumType) and name in owner.__members__:
            members = list(owner.__members__)
            for step in (1, -1):
                other = members[(members.index(name) + step) % len(members)]
                yield self._instead("another member", node, f"{ast.unparse(node.value)}.{other}")

    def _call(self, node: ast.Call) -> Iterator[Mutant]:
        name = getattr(node.func, "id", getattr(node.func, "attr", ""))
        if name in _OTHER_CALL:
            end = self._span(node.func)[1]
            yield self._made("another function", end - len(name), end, _OTHER_CALL[name])
        if name in ("min", "max") and len(node.args) > 1:
            for gone in node.args:
                rest = [each for each in node.args if each is not gone]
                text = ast.unparse(_with(node, args=rest) if len(rest) > 1 else rest[0])
                yield self._instead("bound dropped", node, text if len(rest) > 1 else f"({text})")
        if name == "abs":
            yield self._instead("abs dropped", node, f"({ast.unparse(node.args[0])})")
        if name[:1].isupper() or name == "replace":
            parts = [self._whole(each) for each in (*node.args, *node.keywords)]
            for place in range(len(node.args), len(parts)):
                yield self._without("field dropped", parts, place)
            for (begin, middle), (after, end) in itertools.pairwise(parts[: len(node.args)]):
                swapped = self._source[after:end] + self._source[middle:after] + self._source[begin:middle]
                yield self._made("arguments swapped", begin, end, swapped.decode())

    def _display(self, node: ast.Tuple | ast.List | ast.Set, parent: ast.AST) -> Iterator[Mutant]:
        fixed = isinstance(parent, _OF_FIXED_LENGTH) or (isinstance(parent, ast.Dict) and node in parent.keys)
        if fixed or (isinstance(parent, ast.Assign) and isinstance(parent.targets[0], ast.Tuple)):
            return
        for place in range(len(node.elts)):
            if len(node.elts) > 2:
                yield self._without("element dropped", [self._whole(each) for each in node.elts], place)
            else:
                rest = [*node.elts[:place], *node.elts[place + 1 :]]
                text = "set()" if isinstance(node, ast.Set) and not rest else ast.unparse(_with(node, elts=rest))
                yield self._instead("element dropped", node, text)


def _with(node: ast.AST, **fields: object) -> ast.AST:
    changed = copy.copy(node)
    for name, value in fields.items():
        setattr(changed, name, value)
    return changed


def _names(target: ast.expr) -> set[str]:
    return {node.id for node in ast.walk(target) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}


def _is_constant(node: ast.expr, value: object) -> bool:
    return isinstance(node, ast.Constant) and node.value is value


def _is_words(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)

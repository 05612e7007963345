"""The mistakes: every place of a module at which a small one can be made, and what stands there then.

A mutant replaces one span of the source text, so that it can be shown as a difference of lines a person can read.
Annotations, docstrings and `assert` are left alone: the first two do nothing, the third only tells the type checker.
"""

from __future__ import annotations

import ast
import enum
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

_COMPARISONS: Final[Mapping[type[ast.cmpop], tuple[str, tuple[str, ...]]]] = {
    ast.Lt: ("<", ("<=", ">=")),
    ast.LtE: ("<=", ("<", ">")),
    ast.Gt: (">", (">=", "<=")),
    ast.GtE: (">=", (">", "<")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
    ast.Is: (r"\bis\b", ("is not",)),
    ast.IsNot: (r"\bis\s+not\b", ("is",)),
    ast.In: (r"\bin\b", ("not in",)),
    ast.NotIn: (r"\bnot\s+in\b", ("in",)),
}
_ARITHMETIC: Final[Mapping[type[ast.operator], tuple[str, str]]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.BitOr: ("|", "&"),
    ast.BitAnd: ("&", "|"),
}
_OTHER_CALL: Final[Mapping[str, str]] = {
    "min": "max",
    "max": "min",
    "any": "all",
    "all": "any",
    "sorted": "list",
    "floor": "ceil",
    "trunc": "ceil",
}


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
    minus: tuple[str, ...] = ()
    plus: tuple[str, ...] = ()
    nth: int = 1  # of the mutants with the same words in the same place

    @property
    def place(self) -> str:
        stem = self.module.rpartition(".")[2]
        return f"{stem}.{self.where}" if self.where else stem

    @property
    def key(self) -> tuple[str, str, str, int]:
        """What stays the same when lines above it come and go."""
        return self.place, "\n".join(self.minus), "\n".join(self.plus), self.nth

    def shown(self) -> str:
        """The difference, as a person reads it."""
        head = f"{self.place}, line {self.lines[0]}: {self.operator}"
        return "\n".join(
            (
                head,
                *(f"    - {line}" for line in self.minus),
                *(f"    + {line}" for line in self.plus or ("(nothing)",)),
            )
        )


def mutated(source: str, mutant: Mutant) -> str:
    """The module's text with the mistake in it."""
    text = source.encode()
    return (text[: mutant.start] + mutant.text.encode() + text[mutant.end :]).decode()


def mutants_of(module: str, source: str, namespace: Mapping[str, Any]) -> list[Mutant]:
    """Every mutant of a module, in the order of its text. `namespace`: the imported module's names."""
    seen: set[str] = {source}
    names: Counter[tuple[str, str, str]] = Counter()
    found = []
    for mutant in sorted(_Walk(module, source, namespace).mutants(), key=lambda m: (m.start, m.end, m.text)):
        text = mutated(source, mutant)
        if text in seen:
            continue
        seen.add(text)
        minus, plus = _difference(source, mutant)
        words = (mutant.where, "\n".join(minus), "\n".join(plus))
        names[words] += 1
        found.append(replace(mutant, minus=minus, plus=plus, nth=names[words]))
    return found


def _difference(source: str, mutant: Mutant) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The lines that change: as they are, and as they are then."""
    text = source.encode()
    first = text.rfind(b"\n", 0, mutant.start) + 1
    last = text.find(b"\n", mutant.end)
    old = text[first:last].decode().splitlines()
    new = (text[first : mutant.start] + mutant.text.encode() + text[mutant.end : last]).decode().splitlines()
    while len(old) > 1 and new and old[-1] == new[-1]:
        del old[-1], new[-1]
    while len(old) > 1 and new and old[0] == new[0]:
        del old[0], new[0]
    return tuple(line.strip() for line in old), tuple(line.strip() for line in new if line.strip())


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
        self._keys = sorted(
            {
                node.value
                for node in ast.walk(self._tree)
                if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value.isidentifier()
            }
        )
        self._where: tuple[str, ...] = ()
        self._in_function = False
        self._lines = (1, 1)
        self._assigned: set[str] = set()
        self._returns: ast.expr | None = None

    def mutants(self) -> Iterator[Mutant]:
        yield from self._body(self._tree.body)

    # ------------------------------------------------------------ text

    def _begin(self, node: Any) -> int:
        return int(self._starts[node.lineno - 1] + node.col_offset)

    def _finish(self, node: Any) -> int:
        return int(self._starts[node.end_lineno - 1] + node.end_col_offset)

    def _text(self, start: int, end: int) -> str:
        return self._source[start:end].decode()

    def _of(self, node: Any) -> str:
        return self._text(self._begin(node), self._finish(node))

    def _made(self, operator: str, start: int, end: int, text: str) -> Mutant:
        where, lines = ".".join(self._where), self._lines
        return Mutant(self._module, where, operator, start, end, text, lines, not self._in_function)

    def _instead(self, operator: str, node: ast.AST, text: str) -> Mutant:
        return self._made(operator, self._begin(node), self._finish(node), text)

    def _between(self, operator: str, left: ast.AST, right: ast.AST, pattern: str, text: str) -> Mutant:
        """Replace the sign between two operands; parentheses there stay."""
        start = self._finish(left)
        sign = re.search(pattern, self._text(start, self._begin(right)))
        assert sign is not None
        return self._made(operator, start + sign.start(), start + sign.end(), text)

    # ------------------------------------------------------------ statements

    def _body(self, body: list[ast.stmt]) -> Iterator[Mutant]:
        for statement in body:
            yield from self._statement(statement)

    def _statement(self, node: ast.stmt) -> Iterator[Mutant]:
        outer = self._lines
        self._lines = (node.lineno, self._header_end(node))
        match node:
            case ast.FunctionDef():
                yield from self._function(node)
            case ast.ClassDef():
                self._where = (*self._where, node.name)
                yield from self._body(node.body)
                self._where = self._where[:-1]
            case ast.Import() | ast.ImportFrom() | ast.Assert() | ast.Pass():
                pass
            case ast.Expr(value=ast.Constant()):
                pass  # a docstring
            case ast.Assign(targets=[ast.Name(id="__all__")]):
                pass
            case ast.If():
                yield from self._condition(node.test)
                yield from self._body(node.body)
                yield from self._body(node.orelse)
            case ast.While():
                yield from self._condition(node.test)
                yield from self._body(node.body)
            case ast.For():
                yield from self._expression(node.iter, node)
                self._assigned |= _names(node.target)
                yield from self._body(node.body)
            case ast.Try():
                for part in (node.body, *(handler.body for handler in node.handlers), node.orelse, node.finalbody):
                    yield from self._body(part)
            case ast.Match():
                yield from self._expression(node.subject, node)
                for case in node.cases:
                    for value in ast.walk(case.pattern):
                        if isinstance(value, ast.MatchValue):
                            yield from self._expression(value.value, node)
                    if case.guard is not None:
                        yield from self._condition(case.guard)
                    yield from self._body(case.body)
            case ast.Return():
                yield from self._return(node)
            case ast.Raise():
                yield self._instead("statement removed", node, "pass")
                yield from self._children(node)
            case ast.Continue():
                yield self._instead("continue and break swapped", node, "break")
            case ast.Break():
                yield self._instead("continue and break swapped", node, "continue")
            case ast.Expr():
                yield self._instead("statement removed", node, "pass")
                yield from self._expression(node.value, node)
            case ast.Assign() | ast.AugAssign() | ast.AnnAssign():
                yield from self._assignment(node)
            case _:
                raise NotImplementedError(
                    f"{self._module}, line {node.lineno}: no operator knows {type(node).__name__}"
                )
        self._lines = outer

    @staticmethod
    def _header_end(node: ast.stmt) -> int:
        match node:
            case ast.If() | ast.While():
                return node.test.end_lineno or node.lineno
            case ast.For():
                return node.iter.end_lineno or node.lineno
            case ast.FunctionDef() | ast.ClassDef() | ast.Try() | ast.Match():
                return node.lineno
            case _:
                return node.end_lineno or node.lineno

    def _function(self, node: ast.FunctionDef) -> Iterator[Mutant]:
        outer = self._in_function, self._assigned, self._returns
        for default in (*node.args.defaults, *node.args.kw_defaults):
            if default is not None:
                yield from self._expression(default, node)
        arguments = (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)
        self._in_function, self._assigned, self._returns = True, {a.arg for a in arguments}, node.returns
        self._where = (*self._where, node.name)
        yield from self._body(node.body)
        self._where = self._where[:-1]
        self._in_function, self._assigned, self._returns = outer

    def _return(self, node: ast.Return) -> Iterator[Mutant]:
        if node.value is None:
            yield self._instead("statement removed", node, "pass")
            return
        returns = "" if self._returns is None else ast.unparse(self._returns)
        if returns == "bool":
            yield from self._forced(node.value)
        elif returns.endswith("| None") and not _is_constant(node.value, None):
            yield self._instead("nothing returned", node.value, "None")
        yield from self._expression(node.value, node)

    def _assignment(self, node: ast.Assign | ast.AugAssign | ast.AnnAssign) -> Iterator[Mutant]:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        names = set().union(*(_names(target) for target in targets))
        if self._in_function and names <= self._assigned:  # otherwise the name is simply missing
            yield self._instead("statement removed", node, "pass")
        self._assigned |= names
        if isinstance(node, ast.AugAssign):
            sign, other = _ARITHMETIC[type(node.op)]
            yield self._between("arithmetic", node.target, node.value, re.escape(sign), other)
        if node.value is not None:
            yield from self._expression(node.value, node)

    # ------------------------------------------------------------ expressions

    def _condition(self, node: ast.expr) -> Iterator[Mutant]:
        yield from self._forced(node)
        yield from self._expression(node, node)

    def _forced(self, node: ast.expr) -> Iterator[Mutant]:
        for value in (True, False):
            if not _is_constant(node, value):
                yield self._instead("condition forced", node, str(value))

    def _children(self, node: ast.AST) -> Iterator[Mutant]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.expr):
                yield from self._expression(child, node)
            elif isinstance(child, (ast.keyword, ast.comprehension)):
                yield from self._children(child)

    def _expression(self, node: ast.expr, parent: ast.AST) -> Iterator[Mutant]:
        match node:
            case ast.Compare():
                yield from self._forced(node)
                left = node.left
                for sign, right in zip(node.ops, node.comparators, strict=True):
                    pattern, others = _COMPARISONS[type(sign)]
                    for other in others:
                        yield self._between("comparison", left, right, pattern, other)
                    left = right
            case ast.BoolOp():
                yield from self._bool(node)
            case ast.UnaryOp(op=ast.Not()):
                yield from self._forced(node)
                yield self._instead("not removed", node, re.sub(r"^not\s+", "", self._of(node)))
            case ast.UnaryOp(op=ast.USub()):
                yield self._instead("sign", node, self._of(node)[1:].lstrip())
            case ast.IfExp():
                yield from self._forced(node.test)
            case ast.BinOp():
                words = any(isinstance(part, ast.JoinedStr) or _is_words(part) for part in (node.left, node.right))
                if type(node.op) in _ARITHMETIC and not words:
                    sign_text, other = _ARITHMETIC[type(node.op)]
                    yield self._between("arithmetic", node.left, node.right, re.escape(sign_text), other)
            case ast.Constant():
                yield from self._constant(node)
            case ast.JoinedStr():
                yield self._instead("words removed", node, '""')
                return  # positions inside differ between Python's versions
            case ast.Attribute(value=ast.Name(id=owner)):
                yield from self._member(node, self._namespace.get(owner))
            case ast.Call():
                yield from self._call(node)
            case ast.Tuple() | ast.List() | ast.Set():
                yield from self._display(node, parent)
            case ast.Dict():
                yield from self._dict(node)
            case ast.ListComp() | ast.SetComp() | ast.GeneratorExp() | ast.DictComp():
                for part in node.generators:
                    for test in part.ifs:
                        yield from self._forced(test)
        yield from self._children(node)

    def _bool(self, node: ast.BoolOp) -> Iterator[Mutant]:
        word, other, neutral = ("and", "or", "True") if isinstance(node.op, ast.And) else ("or", "and", "False")
        yield from self._forced(node)
        for left, right in zip(node.values, node.values[1:], strict=False):
            yield self._between("and and or swapped", left, right, rf"\b{word}\b", other)
        for value in node.values:
            yield self._instead("condition dropped", value, neutral)

    def _constant(self, node: ast.Constant) -> Iterator[Mutant]:
        value = node.value
        if isinstance(value, bool):
            yield self._instead("constant", node, str(not value))
        elif isinstance(value, int):
            yield self._instead("constant", node, str(value + 1))
            yield self._instead("constant", node, str(value - 1))
        elif isinstance(value, float):
            yield self._instead("constant", node, repr(value + 1.0))
            yield self._instead("constant", node, repr(-value if value else -1.0))
        elif isinstance(value, str) and value in self._keys and len(self._keys) > 1:
            other = self._keys[(self._keys.index(value) + 1) % len(self._keys)]
            yield self._instead("another name", node, f'"{other}"')
        elif isinstance(value, str):
            yield self._instead("words removed", node, '""' if value else '"words"')

    def _member(self, node: ast.Attribute, owner: Any) -> Iterator[Mutant]:
        if owner is math and node.attr == "inf":
            yield self._instead("sign", node, "-math.inf")
        if not (isinstance(owner, enum.EnumType) and node.attr in owner.__members__):
            return
        members = list(owner.__members__)
        place = members.index(node.attr)
        for step in (1, -1):
            other = members[(place + step) % len(members)]
            if other != node.attr:
                start = self._finish(node.value)
                yield self._made("another member", start, self._finish(node), f".{other}")

    def _call(self, node: ast.Call) -> Iterator[Mutant]:
        match node.func:
            case ast.Name(id=name) | ast.Attribute(attr=name):
                pass
            case _:
                name = ""
        if name in _OTHER_CALL:
            end = self._finish(node.func)
            yield self._made("another function", end - len(name), end, _OTHER_CALL[name])
        if name in ("min", "max") and len(node.args) > 1:
            for gone in node.args:
                rest = [self._of(argument) for argument in node.args if argument is not gone]
                # What remains of two is in parentheses: it may be a sum.
                text = f"{name}({', '.join(rest)})" if len(rest) > 1 else f"({rest[0]})"
                yield self._instead("bound dropped", node, text)
        if name == "abs":
            yield self._instead("abs dropped", node, f"({self._of(node.args[0])})")
        constructor = name[:1].isupper() or name == "replace"
        if constructor:
            parts: list[ast.expr | ast.keyword] = [*node.args, *node.keywords]
            for keyword in node.keywords:
                yield self._without("field dropped", parts, keyword, self._finish(node) - 1)
            for left, right in zip(node.args, node.args[1:], strict=False):
                swapped = self._of(right) + self._text(self._finish(left), self._begin(right)) + self._of(left)
                yield self._made("arguments swapped", self._begin(left), self._finish(right), swapped)

    def _display(self, node: ast.Tuple | ast.List | ast.Set, parent: ast.AST) -> Iterator[Mutant]:
        if not isinstance(node.ctx if not isinstance(node, ast.Set) else ast.Load(), ast.Load):
            return
        if isinstance(parent, (ast.Return, ast.Subscript, ast.Tuple, ast.List, ast.Set, ast.DictComp)):
            return  # of fixed length
        if isinstance(parent, ast.Dict) and node in parent.keys:
            return
        if isinstance(parent, ast.Assign) and isinstance(parent.targets[0], ast.Tuple):
            return
        for gone in node.elts:
            if len(node.elts) > 2:
                yield self._without("element dropped", node.elts, gone, self._finish(node) - 1)
                continue
            rest = "".join(self._of(element) for element in node.elts if element is not gone)
            match node:
                case ast.Tuple():
                    text = f"({rest},)" if rest else "()"
                case ast.List():
                    text = f"[{rest}]"
                case ast.Set():
                    text = f"{{{rest}}}" if rest else "set()"
            yield self._instead("element dropped", node, text)

    def _without(self, operator: str, parts: Sequence[ast.AST], gone: ast.AST, end: int) -> Mutant:
        """One part of an enumeration less: from its first sign to the next part's, or to the closing bracket."""
        after = parts.index(gone) + 1
        return self._made(operator, self._begin(gone), self._begin(parts[after]) if after < len(parts) else end, "")

    def _dict(self, node: ast.Dict) -> Iterator[Mutant]:
        for gone, (key, value) in enumerate(zip(node.keys, node.values, strict=True)):
            # From the entry's first sign to the next entry's, or to the closing bracket
            start = self._begin(value) - 2 if key is None else self._begin(key)
            if gone + 1 < len(node.keys):
                after = node.keys[gone + 1]
                end = self._begin(node.values[gone + 1]) - 2 if after is None else self._begin(after)
            else:
                end = self._finish(node) - 1
            yield self._made("entry dropped", start, end, "")


def _names(target: ast.expr) -> set[str]:
    return {node.id for node in ast.walk(target) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}


def _is_constant(node: ast.expr, value: object) -> bool:
    return isinstance(node, ast.Constant) and node.value is value


def _is_words(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)

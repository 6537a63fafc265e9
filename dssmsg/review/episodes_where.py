"""The language of `episodes --where`: a condition on the fields of a row, parsed and never run as Python.

Fields, text, numbers, `true`, `false`, `none`, lists; `==`, `!=`, `<`, `<=`, `>`, `>=`, `in`, `not in`;
`and`, `or`, `not`; `+`, `-`, `*`, `/` of numbers. A field that a row lacks is `none`: it equals only `none`,
and every other comparison with it is false. What cannot be compared at all, like a number with a text, is
refused.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

from dssmsg.errors import ConfigError

MAX_LENGTH, MAX_PARTS = 2000, 300

Row = Mapping[str, Any]
Term = Callable[[Row], Any]

_WORDS = {"true": True, "false": False, "none": None}
_ORDER: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
_ARITHMETIC: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}


def condition(text: str, fields: Mapping[str, str], key: str = "--where") -> Callable[[Row], bool]:
    """A test of rows. `fields` are the names that rows may have. Raises ConfigError for anything else.

    The test raises ConfigError too, where it comes to values that cannot be compared.
    """
    term = value_of(text, fields, key)
    return lambda row: bool(term(row))


def value_of(text: str, fields: Mapping[str, str], key: str) -> Term:
    """What an expression comes to for a row: text, a number, a truth value, a list or None."""
    if len(text) > MAX_LENGTH:
        raise ConfigError(f"longer than {MAX_LENGTH} characters", key=key)
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = getattr(error, "msg", None) or str(error)
        raise ConfigError(
            f"cannot be read ({reason}); expected like outcome == 'wrong match'", key=key
        ) from error
    if sum(1 for _ in ast.walk(tree)) > MAX_PARTS:
        raise ConfigError(f"more than {MAX_PARTS} parts", key=key)
    return _Reader(fields, key).term(tree.body)


class _Reader:
    def __init__(self, fields: Mapping[str, str], key: str) -> None:
        self._fields = fields
        self._key = key

    def term(self, node: ast.expr) -> Term:
        match node:
            case ast.Constant(value=str() | bool() | int() | float() | None as value):
                return lambda row: value
            case ast.Name(id=name):
                return self._field(name)
            case ast.List(elts=parts) | ast.Tuple(elts=parts):
                terms = [self.term(part) for part in parts]
                return lambda row: [one(row) for one in terms]
            case ast.BoolOp(op=op, values=parts):
                terms = [self.term(part) for part in parts]
                decide = all if isinstance(op, ast.And) else any
                return lambda row: decide(one(row) for one in terms)
            case ast.UnaryOp(op=ast.Not(), operand=part):
                inner = self.term(part)
                return lambda row: not inner(row)
            case ast.UnaryOp(op=ast.USub(), operand=part):
                inner = self.term(part)
                return lambda row: self._number(operator.sub, 0, inner(row), node)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _ARITHMETIC:
                first, second, apply = self.term(left), self.term(right), _ARITHMETIC[type(op)]
                return lambda row: self._number(apply, first(row), second(row), node)
            case ast.Compare(left=left, ops=ops, comparators=others):
                parts = [left, *others]
                terms = list(map(self.term, parts))
                return lambda row: self._all_hold(parts, [one(row) for one in terms], ops)
        raise ConfigError(
            f"'{ast.unparse(node)[:60]}' is not accepted; expected fields, values, comparisons, and, or, not",
            key=self._key,
        )

    def _field(self, name: str) -> Term:
        if name in self._fields:
            return lambda row: row.get(name)
        if name.lower() in _WORDS:
            value = _WORDS[name.lower()]
            return lambda row: value
        raise ConfigError(f"no field '{name}'; there are {', '.join(self._fields)}", key=self._key)

    def _all_hold(self, parts: list[ast.expr], values: list[Any], ops: list[ast.cmpop]) -> bool:
        for n, op in enumerate(ops):
            held = _holds(op, values[n], values[n + 1])
            if held is None:
                raise self._refused(parts[n], parts[n + 1], values[n], values[n + 1])
            if not held:
                return False
        return True

    def _number(
        self, apply: Callable[[float, float], float], left: Any, right: Any, node: ast.expr
    ) -> float | None:
        """A figure; None where a side is none, or the result is not a number."""
        for side in (left, right):
            if isinstance(side, str | list):
                raise ConfigError(
                    f"'{_shown(node)}' reckons with {_kind(side)}; expected numbers", key=self._key
                )
            if side is None or not math.isfinite(side) or abs(side) > 1e100:
                return None
        try:
            return apply(left, right)
        except ZeroDivisionError:
            return None

    def _refused(self, left: ast.expr, right: ast.expr, *values: Any) -> ConfigError:
        kinds = [_kind(value) for value in values]
        return ConfigError(
            f"{_shown(left)} is {kinds[0]} and {_shown(right)} {kinds[1]}: they cannot be compared like that",
            key=self._key,
        )


def _holds(op: ast.cmpop, left: Any, right: Any) -> bool | None:
    """Whether a comparison holds; None where these two cannot be compared."""
    if isinstance(op, ast.Eq | ast.Is):
        return bool(left == right)
    if isinstance(op, ast.NotEq | ast.IsNot):
        return bool(left != right)
    if isinstance(right, list) and isinstance(op, ast.In | ast.NotIn):
        return (left in right) is isinstance(op, ast.In)
    if left is None or right is None:
        return False
    both_texts = isinstance(left, str) and isinstance(right, str)
    if isinstance(op, ast.In | ast.NotIn):
        return (left in right) is isinstance(op, ast.In) if both_texts else None
    both_numbers = isinstance(left, int | float) and isinstance(right, int | float)
    return _ORDER[type(op)](left, right) if both_numbers or both_texts else None


def _kind(value: Any) -> str:
    if isinstance(value, bool):
        return "true or false"
    return "a text" if isinstance(value, str) else "a list" if isinstance(value, list) else "a number"


def _shown(node: ast.expr) -> str:
    return ast.unparse(node)[:60]

"""Arithmetic in files: a text that begins with "=" is computed from numbers and names.

The grammar is closed: numbers, names, + - * / **, brackets, and a few functions. Python's `ast` parses the text, and
this module evaluates the tree; no code is run. Length, depth and powers are limited, so that no text takes long.
"""

import ast
import math
import warnings
from collections.abc import Callable, Mapping
from typing import TypeAlias

from fieldmap.inputs.findings import meant, one_of

Value: TypeAlias = float | str | list[float | str]
MARK = "="
LONGEST = 200
DEEPEST = 20
LARGEST_POWER = 16.0
_GRAMMAR = "an expression of numbers, names, + - * / **, brackets and functions"
_REMEDY = 'write for instance "= 2*(radius + gap)"'


def _degrees(function: Callable[[float], float]) -> Callable[..., float]:
    return lambda angle: function(math.radians(angle))


FUNCTIONS: dict[str, tuple[int, Callable[..., float]]] = {
    "sqrt": (1, math.sqrt),
    "abs": (1, abs),
    "sind": (1, _degrees(math.sin)),
    "cosd": (1, _degrees(math.cos)),
    "tand": (1, _degrees(math.tan)),
    "min": (2, min),
    "max": (2, max),
}
CONSTANTS = {"pi": math.pi}


class ExpressionError(ValueError):
    """A text that cannot be computed: what must hold, what was received, the remedy."""

    def __init__(self, must_hold: str, received: str, remedy: str = _REMEDY) -> None:
        super().__init__(must_hold, received, remedy)
        self.must_hold, self.received, self.remedy = must_hold, received, remedy


def is_expression(value: object) -> bool:
    """Whether a value of a file is to be computed."""
    return isinstance(value, str) and value.startswith(MARK)


def evaluate(text: str, names: Mapping[str, Value]) -> Value:
    """The value of an expression, with or without its "=". Raises ExpressionError.

    A name alone may stand for a text or a list; in arithmetic all are numbers.

    >>> evaluate("= 2*(radius + 1.5)", {"radius": 10.0})
    23.0
    """
    plain = text.removeprefix(MARK).strip()
    shown = f'"{text[:60]}"'
    if len(plain) > LONGEST:
        raise ExpressionError(f"an expression has at most {LONGEST} characters", f"{len(plain)} characters")
    # Python would ignore a remark, which may hide a part of the sum.
    if "#" in plain:
        raise ExpressionError(f"must be {_GRAMMAR}", shown, "write remarks behind the closing quote")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            tree = ast.parse(plain, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError, Warning):
        raise ExpressionError(f"must be {_GRAMMAR}", shown) from None
    if isinstance(tree, ast.Name) and tree.id in names:
        return names[tree.id]
    try:
        value = _number(tree, names, 0)
    except (ZeroDivisionError, OverflowError, ValueError) as wrong:
        if isinstance(wrong, ExpressionError):
            raise
        reason = "a division by zero" if isinstance(wrong, ZeroDivisionError) else str(wrong)
        raise ExpressionError("must have a finite value", f"{reason} in {shown}", "correct it") from None
    if not math.isfinite(value):
        raise ExpressionError("must have a finite value", f"{value} from {shown}", "correct it")
    return value


def _number(node: ast.expr, names: Mapping[str, Value], depth: int) -> float:
    if depth > DEEPEST:
        raise ExpressionError(f"brackets and signs nest at most {DEEPEST} deep", "more", "make it shorter")
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        if isinstance(node.value, bool):
            raise ExpressionError(f"must be {_GRAMMAR}", f'"{node.value}"')
        return float(node.value)
    if isinstance(node, ast.Name):
        return _named(node.id, names)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        value = _number(node.operand, names, depth + 1)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATIONS:
        return _operation(node, names, depth)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        return _call(node.func.id, node.args, names, depth)
    raise ExpressionError(f"must be {_GRAMMAR}", f'"{ast.unparse(node)[:60]}"')


_OPERATIONS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: math.pow(a, b),
}


def _operation(node: ast.BinOp, names: Mapping[str, Value], depth: int) -> float:
    # A sum of many terms is nested on its left side. It is evaluated in a loop, so that only brackets add depth.
    chain = [node]
    while isinstance(chain[-1].left, ast.BinOp) and type(chain[-1].left.op) in _OPERATIONS:
        chain.append(chain[-1].left)
    value = _number(chain[-1].left, names, depth + 1)
    for link in reversed(chain):
        right = _number(link.right, names, depth + 1)
        if isinstance(link.op, ast.Pow) and abs(right) > LARGEST_POWER:
            must_hold = f"a power has an exponent of at most {LARGEST_POWER:g}"
            raise ExpressionError(must_hold, f"{right:g}", "reduce it")
        value = _OPERATIONS[type(link.op)](value, right)
    return value


def _call(name: str, arguments: list[ast.expr], names: Mapping[str, Value], depth: int) -> float:
    known = FUNCTIONS.get(name)
    if known is None:
        must_hold = f"functions are {one_of(list(FUNCTIONS))}"
        raise ExpressionError(must_hold, f'"{name}"', "use one of them; angles are in degrees")
    count, function = known
    if len(arguments) != count:
        raise ExpressionError(f"{name} takes {count}", f"{len(arguments)} arguments", "correct the brackets")
    return float(function(*(_number(one, names, depth + 1) for one in arguments)))


def _named(name: str, names: Mapping[str, Value]) -> float:
    value = names.get(name, CONSTANTS.get(name))
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    known = [key for key, one in {**CONSTANTS, **names}.items() if isinstance(one, int | float)]
    if value is not None:
        what = "a list" if isinstance(value, list) else "a text"
        must_hold = f"{name} must be a number in arithmetic"
        raise ExpressionError(must_hold, what, 'a list alone stands in repeat: x = "= places"')
    remedy = meant(name, known, f"add {name} to [parameters]", quote="")
    raise ExpressionError(f"names are those of [parameters]: {one_of(known)}", f'"{name}"', remedy)

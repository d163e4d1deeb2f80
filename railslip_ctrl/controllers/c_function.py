"""Translates a controller's `step`, or a function that it calls, from Python to C99."""

from __future__ import annotations

import ast
import copy
import math
import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import Any, TypeGuard

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass

from .translate import MATH, STATE, Function, ends, returned_values

WIDTH = 100  #: largest number of characters of a line of C
_OPERATORS: dict[type[ast.AST], str] = {
    **{ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Mod: "%"},
    **{ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="},
    **{ast.And: "&&", ast.Or: "||", ast.Not: "!", ast.USub: "-", ast.UAdd: "+"},
}
# names reserved by C, C++, embedded compilers, or the program itself
_RESERVED = frozenset(
    """alignas alignof and and_eq asm auto bitand bitor bool break case catch char class compl concept const const_cast
    constexpr continue decltype default delete do double dynamic_cast else enum explicit export extern false far float
    for friend goto huge if inline int interrupt long mutable namespace near new noexcept not not_eq nullptr operator or
    or_eq private protected public register reinterpret_cast requires restrict return short signed sizeof static
    static_assert static_cast struct switch template this thread_local throw true try typedef typeid typename typeof
    union unsigned using virtual void volatile wchar_t while xor xor_eq main floor ceil y0 y1 yn j0 j1 jn gamma
    NAN INFINITY HUGE_VAL M_PI M_E real lesser larger square modulo is_finite""".split()  # noqa: SIM905
) | {name for function in MATH for name in (function, f"{function}f")}


def c_name(name: str) -> str:
    """Return a name for C: without leading underscores, and with a trailing underscore if it is reserved."""
    name = name.lstrip("_")
    return f"{name}_" if name.rstrip("_") in _RESERVED else name


@dataclass(frozen=True)
class Structures:
    """Names of the C structures for state, parameters and measurement, lengths of their arrays, prefix of functions."""

    types: Mapping[str, str]
    lengths: Mapping[tuple[str, str], int] = field(default_factory=dict)
    prefix: str = ""


def writes_state(function: Function) -> bool:
    """Return True if a function, or one that it calls, writes a field of the state."""
    stores = (node for node in ast.walk(function.node) if isinstance(node, ast.Attribute | ast.Subscript))
    own = any(isinstance(node.ctx, ast.Store) for node in stores)
    return own or any(writes_state(called) for called in function.calls.values())


class CFunction:
    """C translation of a Python function, with one `return`; variables that are assigned once are `const`."""

    def __init__(self, function: Function, structures: Structures) -> None:
        self._function, self._structures = function, structures
        self._values = returned_values(function)
        used = {c_name(node.id) for node in ast.walk(function.node) if isinstance(node, ast.Name)}
        self._result, self._returned = _unused("result", used), _unused("returned", used)
        body = copy.deepcopy(function.node.body)
        self._body = _Returns(self._values, self._result, self._returned).body(body)
        self._read = {part.id for part in self._walk() if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Load)}
        self._ints = self._whole_names()
        self._constants = {id(node) for node in self._declared_at_once()}

    @property
    def name(self) -> str:
        return self._function.name

    @property
    def head(self) -> str:
        function, arguments = self._function, []
        for name in function.arguments:
            role = function.roles.get(name)
            constant = "" if role == STATE and writes_state(function) else "const "
            arguments.append(
                f"real {c_name(name)}" if role is None else f"{constant}{self._structures.types[role]} *{c_name(name)}"
            )
        arguments += [f"real *{name}" for name in self._outputs]
        kind = "real" if self._values == 1 else "void"
        return f"static {kind} {self._structures.prefix}{function.name}({', '.join(arguments)})"

    @property
    def text(self) -> str:
        doc = commented(" ".join(self._function.doc.split()))
        comment = textwrap.wrap(f"/* {doc} */", WIDTH, subsequent_indent="   ")
        declared = [f"int {name} = 0;" for name in sorted(self._ints & self._variables)]
        declared += [f"real {c_name(name)} = REAL(0.0);" for name in sorted(self._variables - self._ints)]
        result = [f"return {self._result};"] if self._values == 1 else []
        outputs = [f"*{name} = {name[:-4]};" for name in self._outputs]
        body = self._statements(self._body)
        unused = [
            f"(void){c_name(name)};"
            for name in self._function.arguments
            if not any(re.search(rf"\b{c_name(name)}\b", line) for line in body)
        ]
        lines = [*unused, *declared, *body, *outputs, *result]
        head = textwrap.wrap(self.head.replace(" *", "\N{NO-BREAK SPACE}*"), WIDTH, subsequent_indent="        ")
        head = [line.replace("\N{NO-BREAK SPACE}", " ") for line in head]
        return "\n".join([*(comment if self._function.doc else []), *head, "{", *indented(lines), "}"])

    @property
    def _outputs(self) -> list[str]:
        return [f"{self._result}{i}_out" for i in range(self._values)] if self._values > 1 else []

    @property
    def _variables(self) -> set[str]:
        variables = set()
        for node in self._walk():
            if isinstance(node, ast.Assign) and id(node) not in self._constants:
                variables |= {part.id for target in node.targets for part in _names(target)}
            elif isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
                variables.add(node.target.id)
        return variables - set(self._function.arguments)

    def _walk(self) -> Iterator[ast.AST]:
        for statement in self._body:
            yield from ast.walk(statement)

    def _whole_names(self) -> set[str]:
        values: dict[str, list[ast.expr | None]] = {}
        for node in self._walk():
            if isinstance(node, ast.Assign):
                for target, value in _pairs(node):
                    for part in _names(target):
                        values.setdefault(part.id, []).append(value)
            elif isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
                values.setdefault(node.target.id, []).append(
                    ast.Constant(0.5) if isinstance(node.op, ast.Div) else node.value
                )
            elif isinstance(node, ast.For):
                values.setdefault(_names(node.target)[0].id, []).append(ast.Constant(0))
        whole = set(values) - set(self._function.arguments) - {self._result}
        while True:
            kept = {
                name for name in whole if all(part is not None and self._is_whole(part, whole) for part in values[name])
            }
            if kept == whole:
                return whole
            whole = kept

    def _is_whole(self, node: ast.expr, names: set[str] | None = None) -> bool:
        names = self._ints if names is None else names
        match node:
            case ast.Constant():
                return isinstance(node.value, int)
            case ast.BoolOp():
                return all(self._is_whole(part, names) for part in node.values)
            case ast.Name():
                return node.id in names or isinstance(self._function.constants.get(node.id), int)
            case ast.Call(func=ast.Name(id="int" | "len")) | ast.Compare():
                return True
            case ast.UnaryOp():
                return isinstance(node.op, ast.Not) or self._is_whole(node.operand, names)
            case ast.BinOp():
                whole = self._is_whole(node.left, names) and self._is_whole(node.right, names)
                return whole and not isinstance(node.op, ast.Div | ast.Pow)
            case ast.IfExp():
                return self._is_whole(node.body, names) and self._is_whole(node.orelse, names)
        return False

    def _declared_at_once(self) -> Iterator[ast.stmt]:  # assignments that can be `const` declarations
        uses: dict[str, int] = {}
        stores: dict[str, int] = {}
        for node in self._walk():
            if isinstance(node, ast.Name):
                uses[node.id] = uses.get(node.id, 0) + 1
                stores[node.id] = stores.get(node.id, 0) + isinstance(node.ctx, ast.Store)
        for block in _blocks(self._body):
            for k, statement in enumerate(block):
                if not isinstance(statement, ast.Assign) or len(statement.targets) > 1:
                    continue
                names = _names(statement.targets[0])
                if not names or len(names) != len(_elements(statement.targets[0])):
                    continue
                if isinstance(statement.targets[0], ast.Tuple) and not isinstance(statement.value, ast.Tuple):
                    continue
                here = [part.id for part in names]
                seen = {name: sum(_uses(part, name) for part in block[k:]) for name in here}
                first = all(stores[name] == 1 and seen[name] == uses[name] for name in here)
                if first and not set(here) & set(self._function.arguments):
                    yield statement

    def _statements(self, nodes: list[ast.stmt]) -> list[str]:
        return [line for node in nodes for line in self._statement(node)]

    def _statement(self, node: ast.stmt) -> list[str]:
        match node:
            case ast.Assign():
                return self._assigned(node)
            case ast.AugAssign():
                whole = isinstance(node.target, ast.Name) and node.target.id in self._ints
                if isinstance(node.op, ast.Mod | ast.Pow):
                    return [f"{self._text(node.target)} = {self._bare(_changed(node), not whole)};"]
                return [f"{self._text(node.target)} {_OPERATORS[type(node.op)]}= {self._bare(node.value, not whole)};"]
            case ast.If():
                other = ["} else {", *indented(self._statements(node.orelse))] if node.orelse else []
                if len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If):
                    first, *rest = self._statement(node.orelse[0])
                    return [
                        f"if ({self._condition(node.test)}) {{",
                        *indented(self._statements(node.body)),
                        f"}} else {first}",
                        *rest,
                    ]
                return [f"if ({self._condition(node.test)}) {{", *indented(self._statements(node.body)), *other, "}"]
            case ast.While():
                test = self._condition(node.test)
                test = f"{self._returned} == 0 && ({test})" if self._sets_returned(node) else test
                return [f"while ({test}) {{", *indented(self._statements(node.body)), "}"]
            case ast.For():
                return self._loop(node)
            case ast.Expr():
                return [f"{self._text(node.value)};"]
            case ast.Pass():
                return []
        raise self._untranslatable(node)

    def _loop(self, node: ast.For) -> list[str]:
        assert isinstance(node.iter, ast.Call), "`translate` allows only range()"
        (target,), (*begin, end) = _names(node.target), node.iter.args
        name, before = c_name(target.id), list[str]()
        first, last = (self._whole(part) for part in (begin[0] if begin else ast.Constant(0), end))
        if not last.isdecimal():  # evaluate the end once, before the loop
            before, last = [f"const int {name}_end = {last};"], f"{name}_end"
        stop = f"{self._returned} == 0 && " if self._sets_returned(node) else ""
        head = f"for (int {name} = {first}; {stop}{name} < {last}; {name}++) {{"
        lines = [head, *indented(self._statements(node.body)), "}"]
        return [*before, *lines] if not before else ["{", *indented([*before, *lines]), "}"]

    def _sets_returned(self, node: ast.AST) -> bool:
        return any(isinstance(part, ast.Name) and part.id == self._returned for part in ast.walk(node))

    def _assigned(self, node: ast.Assign) -> list[str]:
        if isinstance(node.value, ast.Call) and isinstance(node.targets[0], ast.Tuple):
            outputs = [f"&{self._text(part)}" for part in _elements(node.targets[0])]
            return [f"{self._call(node.value, outputs)};"]
        lines, constant, pairs = [], id(node) in self._constants, list(_pairs(node))
        texts = {ast.unparse(target) for target, _ in pairs}
        for _, value in pairs[1:]:
            if value is not None and any(
                ast.unparse(part) in texts for part in ast.walk(value) if isinstance(part, ast.expr)
            ):
                raise self._untranslatable(node)  # a value depends on a target of the same assignment
        for target, value in pairs:
            assert value is not None
            whole = isinstance(target, ast.Name) and target.id in self._ints
            declared = f"const {'int' if whole else 'real'} " if constant else ""
            lines.append(f"{declared}{self._text(target)} = {self._bare(value, not whole)};")
            if isinstance(target, ast.Name) and target.id not in self._read and target.id != self._result:
                lines.append(f"(void){c_name(target.id)};")
        return lines

    def _bare(self, node: ast.expr, real: bool = False) -> str:
        text = self._text(node, real)
        inner = isinstance(node, ast.BinOp | ast.BoolOp | ast.Compare | ast.IfExp)
        return text[1:-1] if inner and text.startswith("(") and not text.startswith("(real)") else text

    def _whole(self, node: ast.expr) -> str:
        return self._bare(node) if self._is_whole(node) else f"(int){self._text(node, True)}"

    def _truth(self, node: ast.expr) -> str:
        if isinstance(node, ast.BoolOp):
            return f"({f' {_OPERATORS[type(node.op)]} '.join(map(self._truth, node.values))})"
        return f"!({self._condition(node.operand)})" if _is_not(node) else self._text(node)

    def _condition(self, node: ast.expr) -> str:
        return self._truth(node)[1:-1] if isinstance(node, ast.BoolOp) else self._bare(node)

    def _chosen(self, node: ast.BoolOp) -> str:
        if _is_truth(node):
            return self._truth(node)
        as_real = not self._is_whole(node)  # in Python the value of `and` or `or` is one of the operands
        *others, text = (self._text(part, as_real) for part in node.values)
        for other, operand in zip(reversed(others), reversed(node.values[:-1]), strict=True):
            sides = (text, other) if isinstance(node.op, ast.And) else (other, text)
            text = f"({self._truth(operand)} ? {' : '.join(sides)})"
        return text

    def _text(self, node: ast.expr, real: bool = False) -> str:
        if real and self._is_whole(node) and not isinstance(node, ast.Constant):
            return f"(real){self._text(node)}"
        match node:
            case ast.Constant(value=bool() | int() | float() as value):
                return number(float(value) if real else value)
            case ast.Name() | ast.Attribute() | ast.Subscript():
                return self._variable(node, real)
            case ast.BinOp():
                return self._operation(node)
            case ast.UnaryOp(op=ast.Not()):
                return self._truth(node)
            case ast.UnaryOp():
                return f"({_OPERATORS[type(node.op)]}{self._text(node.operand)})"
            case ast.BoolOp():
                return self._chosen(node)
            case ast.Compare():
                return self._comparison(node)
            case ast.IfExp():
                as_real = not self._is_whole(node)
                sides = (self._text(part, as_real) for part in (node.body, node.orelse))
                return f"({self._truth(node.test)} ? {' : '.join(sides)})"
            case ast.Call():
                return self._call(node)
        raise self._untranslatable(node)

    def _variable(self, node: ast.Name | ast.Attribute | ast.Subscript, real: bool) -> str:
        if isinstance(node, ast.Name):
            value = self._function.constants.get(node.id)
            return c_name(node.id) if value is None else number(float(value) if real else value)
        if isinstance(node, ast.Subscript):
            return f"{self._text(node.value)}[{self._whole(node.slice)}]"
        assert isinstance(node.value, ast.Name)
        if node.value.id == "math":
            return number(getattr(math, node.attr))
        return f"{c_name(node.value.id)}->{c_name(node.attr)}"

    def _comparison(self, node: ast.Compare) -> str:
        sides = [node.left, *node.comparators]
        real = not all(self._is_whole(part) for part in sides)
        pairs = zip(sides[:-1], node.ops, sides[1:], strict=True)
        texts = [f"({self._text(a, real)} {_OPERATORS[type(op)]} {self._text(b, real)})" for a, op, b in pairs]
        return texts[0] if len(texts) == 1 else f"({' && '.join(texts)})"

    def _operation(self, node: ast.BinOp) -> str:
        as_real = not self._is_whole(node)
        left = self._text(node.left, as_real)
        if isinstance(node.op, ast.Pow):
            power = node.right.value if isinstance(node.right, ast.Constant) else None
            return (
                f"square({self._bare(node.left, True)})"
                if power == 2
                else f"REAL_POW({left}, {self._bare(node.right, True)})"
            )
        if isinstance(node.op, ast.Mod):
            if as_real:
                raise self._untranslatable(node)
            return f"modulo({self._bare(node.left)}, {self._bare(node.right)})"
        return f"({left} {_OPERATORS[type(node.op)]} {self._text(node.right, as_real)})"

    def _call(self, node: ast.Call, outputs: list[str] | None = None) -> str:
        function = self._function
        if isinstance(node.func, ast.Name) and node.func.id in function.calls:
            called = function.calls[node.func.id]
            given = zip(called.arguments, node.args, strict=True)
            arguments = [self._text(part) if name in called.roles else self._bare(part, True) for name, part in given]
            return f"{self._structures.prefix}{called.name}({', '.join([*arguments, *(outputs or [])])})"
        if isinstance(node.func, ast.Attribute):
            name = "is_finite" if node.func.attr == "isfinite" else f"REAL_{node.func.attr.upper()}"
            return f"{name}({', '.join(self._bare(part, True) for part in node.args)})"
        assert isinstance(node.func, ast.Name)
        first = node.args[0]
        match node.func.id:
            case "len":
                assert isinstance(first, ast.Attribute)
                return str(self._structures.lengths[function.role(first.value) or "", first.attr])
            case "int":
                return f"(int){self._text(first, True)}"
            case "float":
                return self._text(first, True)
            case "abs":
                return f"REAL_FABS({self._bare(first, True)})"
        name = {"min": "lesser", "max": "larger"}[node.func.id]
        text = self._bare(first, True)
        for part in node.args[1:]:
            text = f"{name}({text}, {self._bare(part, True)})"
        return text

    def _untranslatable(self, node: ast.AST) -> InputError:
        return InputError(
            f"{self._function.name}: {ast.unparse(node)!r} cannot be translated to C; write it in simpler statements"
        )

    def operations(self, bound: int, counts: Mapping[str, int]) -> int:
        """Return an upper bound on the arithmetic operations of one call; `counts` has those of the called functions.

        It assumes that loops without a fixed end run `bound` times.
        """
        return sum(self._count(statement, bound, counts) for statement in self._body)

    def _count(self, node: ast.AST, bound: int, counts: Mapping[str, int]) -> int:
        own, turns = int(isinstance(node, _COUNTED)), 1
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in self._function.calls:
            own = counts[self._function.calls[node.func.id].name]
        if isinstance(node, ast.For | ast.While):
            turns = bound
        if isinstance(node, ast.For) and isinstance(node.iter, ast.Call):
            end = self._whole(node.iter.args[-1])
            turns = int(end) if end.isdecimal() else bound
        return own + turns * sum(self._count(child, bound, counts) for child in ast.iter_child_nodes(node))


_COUNTED = (ast.BinOp, ast.UnaryOp, ast.Compare, ast.AugAssign, ast.Call, ast.IfExp)


class _Returns:
    """Rewrites the `return` statements of a function body as assignments and branches, so that C needs one `return`."""

    def __init__(self, values: int, result: str, returned: str) -> None:
        self._names = [result] if values == 1 else [f"{result}{i}" for i in range(values)]
        self._returned = returned

    def body(self, nodes: list[ast.stmt], in_loop: bool = False) -> list[ast.stmt]:
        done: list[ast.stmt] = []
        for k, node in enumerate(nodes):
            rest = nodes[k + 1 :]
            if isinstance(node, ast.Return):
                return [*done, *self._result(node, in_loop)]
            if isinstance(node, ast.If) and _has_return(node):
                sides = (
                    self.body(side if ends(side) else [*side, *copy.deepcopy(rest)], in_loop)
                    for side in (node.body, node.orelse)
                )
                return [*done, ast.If(node.test, next(sides) or [ast.Pass()], next(sides))]
            if isinstance(node, ast.For | ast.While) and _has_return(node):
                begin = ast.Assign([ast.Name(self._returned, ast.Store())], ast.Constant(0))
                node.body = self.body(node.body, in_loop=True)
                after = self.body(rest, in_loop)
                test = ast.Compare(ast.Name(self._returned, ast.Load()), [ast.Eq()], [ast.Constant(0)])
                return [*done, begin, node, *([ast.If(test, after, [])] if after else [])]
            done.append(node)
        return done

    def _result(self, node: ast.Return, in_loop: bool) -> list[ast.stmt]:
        values = [] if node.value is None else _elements(node.value)
        statements: list[ast.stmt] = (
            [ast.Assign([ast.Name(name, ast.Store())], value) for name, value in zip(self._names, values, strict=True)]
            if values
            else []
        )
        if in_loop:
            statements.append(ast.Assign([ast.Name(self._returned, ast.Store())], ast.Constant(1)))
        return statements


def _has_return(node: ast.AST) -> bool:
    return any(isinstance(part, ast.Return) for part in ast.walk(node))


def _unused(name: str, used: set[str]) -> str:
    return name if name not in used else _unused(f"{name}_", used)


def _is_not(node: ast.expr) -> TypeGuard[ast.UnaryOp]:
    return isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)


def _is_truth(node: ast.expr) -> bool:
    if isinstance(node, ast.BoolOp):
        return all(map(_is_truth, node.values))
    return isinstance(node, ast.Compare) or _is_not(node)


def _changed(node: ast.AugAssign) -> ast.BinOp:
    old: Any = copy.deepcopy(node.target)
    old.ctx = ast.Load()
    return ast.BinOp(old, node.op, node.value)


def _blocks(nodes: list[ast.stmt]) -> Iterator[list[ast.stmt]]:
    yield nodes
    for node in nodes:
        for name in ("body", "orelse"):
            if inner := getattr(node, name, None):
                yield from _blocks(inner)


def _uses(node: ast.AST, name: str) -> int:
    return sum(isinstance(part, ast.Name) and part.id == name for part in ast.walk(node))


def _elements(node: ast.expr) -> list[ast.expr]:
    return list(node.elts) if isinstance(node, ast.Tuple) else [node]


def _names(node: ast.expr) -> list[ast.Name]:
    return [part for part in _elements(node) if isinstance(part, ast.Name)]


def _pairs(node: ast.Assign) -> Iterator[tuple[ast.expr, ast.expr | None]]:
    for target in node.targets:
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            yield from zip(target.elts, node.value.elts, strict=True)
        elif isinstance(target, ast.Tuple):
            yield from ((part, None) for part in target.elts)  # a called function returns several values
        else:
            yield target, node.value


def number(value: float) -> str:
    """Return the C text of a number."""
    if isinstance(value, bool | int):
        return str(int(value))
    if not math.isfinite(value):
        return "REAL(NAN)" if math.isnan(value) else f"({'-' if value < 0 else ''}REAL(HUGE_VAL))"
    return f"REAL({value!r})" if value >= 0 else f"(-REAL({-value!r}))"


def commented(text: str) -> str:
    """Return text without character sequences that are not allowed inside a C comment."""
    return text.replace("*/", "* /").replace("/*", "/ *").replace("\\", "/")


def indented(lines: list[str]) -> list[str]:
    """Return lines of C, indented by four characters and wrapped to at most `WIDTH` characters."""
    wrapped = []
    for line in lines:
        margin = " " * (len(line) - len(line.lstrip()) + 12)
        wrapped += textwrap.wrap("    " + line, WIDTH, subsequent_indent=margin, break_long_words=False) or [""]
    return wrapped

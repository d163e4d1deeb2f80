"""Translates the control law of a controller, its function `step`, for the compiled simulation.

The function step(state, measurement, parameters) and the functions that it calls are read from their Python source.
They may use numbers, assignments, `if`, `while`, `for ... in range(...)`, `return`, the functions `min`, `max`, `abs`,
`int`, `float` and `len`, functions of `math` (`MATH`), constants of their modules, and the fields of the three records.
They may change only fields of the state.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from types import FunctionType, MappingProxyType
from typing import Any, TypeVar

from railslip_ctrl.core.errors import InputError
from railslip_ctrl.core.records import dataclass
from railslip_ctrl.core.user_files import place

F = TypeVar("F", bound=Callable[..., Any])

STATE, MEASUREMENT, PARAMETERS = "state", "measurement", "parameters"
ROLES = (STATE, MEASUREMENT, PARAMETERS)  #: roles of the arguments of `step`, in order

# fields of a measurement, with their names in the translated text
MEASURED = MappingProxyType({"time": "_t", "train_speed": "_v", "wheel_speed": "_omega", "applied_torque": "_applied"})
BUILTINS = ("min", "max", "abs", "int", "float", "len", "range")
# functions of `math` that Numba and C also have, with their numbers of arguments
MATH = {
    **dict.fromkeys(("exp", "log", "sqrt", "fabs", "sin", "cos", "tan", "asin", "acos", "atan", "tanh", "isfinite"), 1),
    **dict.fromkeys(("pow", "atan2", "hypot", "copysign"), 2),
}
_NODES = (
    *(ast.FunctionDef, ast.arguments, ast.arg, ast.Assign, ast.AugAssign, ast.Expr, ast.If, ast.While, ast.For),
    *(ast.Return, ast.Pass, ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Call, ast.Constant),
    *(ast.Name, ast.Attribute, ast.Subscript, ast.Tuple, ast.expr_context),
    *(ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Mod, ast.Pow, ast.USub, ast.UAdd, ast.Not, ast.And, ast.Or),
    *(ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq),
)
_LARGEST_WHOLE = 2**31 - 1  # largest signed integer of 32 bits


@dataclass(frozen=True)
class Function:
    """Source of a function `step`, or of a function that it calls.

    - name: unique among the functions that are translated together.
    - node: syntax tree of the function, without decorators, annotations and docstring.
    - roles: role of each argument that is a record: "state", "measurement" or "parameters".
    - constants, calls: constants and functions that the function uses; the keys are their names.
    - is_outside: True if the function is marked as `outside` and is therefore not translated.
    """

    name: str
    node: ast.FunctionDef
    doc: str
    roles: Mapping[str, str]
    constants: Mapping[str, float | int | bool]
    calls: dict[str, Function] = field(default_factory=dict)
    is_outside: bool = False

    @property
    def arguments(self) -> tuple[str, ...]:
        return tuple(argument.arg for argument in self.node.args.args)

    def role(self, node: ast.AST) -> str | None:
        return self.roles.get(node.id) if isinstance(node, ast.Name) else None

    def all(self) -> dict[str, Function]:
        """Return this function and all functions that it calls, by name; a called function comes before its caller."""
        functions: dict[str, Function] = {}
        for called in self.calls.values():
            functions |= {name: each for name, each in called.all().items() if name not in functions}
        return functions | {self.name: self}


def outside(function: F) -> F:
    """Mark a `function` as not to be translated; each translated program must define a function of this name itself."""
    function.__dict__["is_outside"] = True
    return function


def with_functions(step: Callable[..., Any], functions: Mapping[str, Callable[..., Any]]) -> Callable[..., Any]:
    """Return a copy of `step` that calls the given `functions` instead of the global functions of the same names."""
    assert isinstance(step, FunctionType), "a kind's step is a static method"
    return FunctionType(step.__code__, {**step.__globals__, **functions}, step.__name__) if functions else step


def read_step(step: Callable[..., Any], roles: Mapping[str, str] | None = None) -> Function:
    """Read the source of a function `step` and of all functions that it calls.

    `roles` maps argument names to roles; by default the first three arguments have the roles `ROLES`. InputError,
    with file and line, for code that cannot be translated.
    """
    arguments = tuple(inspect.signature(step).parameters)[: len(ROLES)]
    if roles is None and len(arguments) < len(ROLES):
        raise InputError(f"{_place(step, 0)}: step takes {len(arguments)} arguments; define step({', '.join(ROLES)})")
    assert isinstance(step, FunctionType), "a kind's step is a static method"
    return _read(step, dict(zip(arguments, ROLES, strict=True)) if roles is None else roles, {}, ())


def returned_values(function: Function) -> int:
    """Return the number of values that a function returns."""
    return max((_values(node) for node in ast.walk(function.node) if isinstance(node, ast.Return)), default=0)


def _values(node: ast.Return) -> int:
    return 0 if node.value is None else len(node.value.elts) if isinstance(node.value, ast.Tuple) else 1


def ends(nodes: Sequence[ast.stmt]) -> bool:
    """Return True if every path through the statements ends with a return."""
    last = nodes[-1] if nodes else None
    if isinstance(last, ast.If):
        return ends(last.body) and ends(last.orelse)
    return isinstance(last, ast.Return)


def _place(function: Any, line: int) -> str:
    return place(function.__code__.co_filename, function.__code__.co_firstlineno + line)


def _read(
    function: FunctionType,
    roles: Mapping[str, str],
    known: dict[FunctionType, Function],
    above: tuple[FunctionType, ...],
) -> Function:
    if function in above:
        raise InputError(f"{_place(function, 0)}: {function.__name__} calls itself; write a loop")
    if function in known:
        if dict(known[function].roles) != dict(roles):
            raise InputError(
                f"{_place(function, 0)}: calls of {function.__name__} pass state, measurement or parameters in "
                "different positions; use the same positions in every call"
            )
        return known[function]
    try:
        text = textwrap.dedent(inspect.getsource(function))
    except (OSError, TypeError):
        raise InputError(f"{function.__name__}: its source cannot be read; write it into a file") from None
    try:
        node = ast.parse(text).body[0]
    except SyntaxError:  # for example a lambda in the middle of a line
        node = ast.Pass()
    if not isinstance(node, ast.FunctionDef):
        raise InputError(f"{_place(function, 0)}: {function.__name__} cannot be translated; write it with def")
    doc = ast.get_docstring(node) or ""
    if doc:
        node.body = node.body[1:] or [ast.Pass()]
    node.decorator_list, node.returns = [], None
    for argument in node.args.args:
        argument.annotation = None
    name, used = function.__name__, {other.name for other in known.values()}
    while name in used:
        name += "_"
    read = Function(name, node, doc, dict(roles), {}, {}, getattr(function, "is_outside", False))
    known[function] = read
    if not read.is_outside:
        _check(read, function)
        constants, calls = _names(read, function, known, (*above, function))
        read.calls.update(calls)
        object.__setattr__(read, "constants", constants)
    return read


def _check(read: Function, function: FunctionType) -> None:
    for node, why in _faults(read):
        raise InputError(f"{_place(function, getattr(node, 'lineno', 1) - 1)}: {why}")


def _faults(read: Function) -> Iterator[tuple[ast.AST, str]]:
    parts = list(ast.walk(read.node))
    by_name = {id(part) for node in parts if isinstance(node, ast.Call) for part in node.args}
    by_name |= {id(node.value) for node in parts if isinstance(node, ast.Attribute)}
    stored = {part.id for part in parts if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)}
    for name in (*stored, *read.arguments):
        if name.startswith("_"):
            yield read.node, f"{name!r} begins with _, which is not allowed for names in a step; rename it"
    for node in parts:
        kind = type(node).__name__
        if not isinstance(node, _NODES) or (isinstance(node, ast.FunctionDef) and node is not read.node):
            yield node, f"{kind} cannot be translated; use assignments, if, while, for, return and numbers"
        if isinstance(node, ast.For | ast.While) and node.orelse:
            yield node, f"{kind} with else cannot be translated; write it without else"
        if isinstance(node, ast.For):
            yield from _loop_faults(node, parts)
        if isinstance(node, ast.Constant):
            yield from _constant_faults(node)
        if isinstance(node, ast.Name) and node.id in read.roles and id(node) not in by_name:
            yield node, f"{node.id} is not a number; write {node.id}.NAME, or pass it to a function"
        if isinstance(node, ast.Attribute | ast.Subscript):
            yield from _field_faults(node, read)
        if isinstance(node, ast.Call):
            yield from _call_faults(node)
    yield from _return_faults(read, [node for node in parts if isinstance(node, ast.Return)])


def _constant_faults(node: ast.Constant) -> Iterator[tuple[ast.AST, str]]:
    if not isinstance(node.value, int | float):
        yield node, f"{node.value!r} is not a number; a step may use only numbers"
    elif isinstance(node.value, int) and node.value > _LARGEST_WHOLE:
        yield node, f"{node.value} is too large for an integer, largest {_LARGEST_WHOLE}; write {float(node.value)!r}"


def _call_faults(node: ast.Call) -> Iterator[tuple[ast.AST, str]]:
    if isinstance(node.func, ast.Attribute) and MATH.get(node.func.attr) != len(node.args):
        yield (
            node,
            f"{ast.unparse(node)} cannot be translated; a step may call these functions of math: {', '.join(MATH)}",
        )


def _return_faults(read: Function, returns: Sequence[ast.Return]) -> Iterator[tuple[ast.AST, str]]:
    if len({_values(node) for node in returns}) > 1:
        yield returns[-1], "the returns give different numbers of values; return the same number of values everywhere"
    if returned_values(read) and not ends(read.node.body):
        yield read.node, f"{read.name} may end without a return; end it with a return"


def _field_faults(node: ast.Attribute | ast.Subscript, read: Function) -> Iterator[tuple[ast.AST, str]]:
    field_ = node.value if isinstance(node, ast.Subscript) else node
    if isinstance(node.ctx, ast.Store) and (not isinstance(field_, ast.Attribute) or read.role(field_.value) != STATE):
        yield node, f"{ast.unparse(node)} is written; a step may write only the state"
    if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.UnaryOp):
        yield node, f"{ast.unparse(node)} has a negative index; write the index with len(...)"


def _loop_faults(loop: ast.For, parts: Sequence[ast.AST]) -> Iterator[tuple[ast.AST, str]]:
    call, target = loop.iter, loop.target
    is_range = isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "range"
    if not (is_range and 1 <= len(call.args) <= 2 and isinstance(target, ast.Name)):  # type: ignore[attr-defined]
        yield loop, f"for {ast.unparse(target)} in {ast.unparse(call)}: write it with range(END) or range(START, END)"
        return
    uses = [part for part in parts if isinstance(part, ast.Name) and part.id == target.id]
    mine = [part for each in parts if _is_loop(each, target.id) for part in ast.walk(each)]
    stores = [part for part in ast.walk(loop) if part in uses and isinstance(part.ctx, ast.Store)]
    if len(stores) > 1 or any(part not in mine for part in uses):
        yield loop, f"{target.id} is used outside its loop or changed inside; use a second variable"


def _is_loop(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.For) and isinstance(node.target, ast.Name) and node.target.id == name


def _names(
    read: Function, function: FunctionType, known: dict[FunctionType, Function], above: tuple[FunctionType, ...]
) -> tuple[dict[str, float | int | bool], dict[str, Function]]:
    parts = list(ast.walk(read.node))
    stored = {part.id for part in parts if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)}
    own = stored | set(read.arguments)
    constants: dict[str, float | int | bool] = {}
    calls: dict[str, Function] = {}
    for part in parts:
        if not isinstance(part, ast.Name) or part.id in own or part.id in constants or part.id in calls:
            continue
        where = _place(function, part.lineno - 1)
        value = function.__globals__.get(part.id, getattr(builtins, part.id, None))
        value = getattr(value, "py_func", value)
        called = [node for node in parts if isinstance(node, ast.Call) and _is_name(node.func, part.id)]
        if isinstance(value, FunctionType) and called:
            names = tuple(inspect.signature(value).parameters)
            if any(len(node.args) != len(names) for node in called):
                raise InputError(f"{where}: {part.id} takes {len(names)} arguments; give all of them, in order")
            given = [{name: read.role(arg) for name, arg in zip(names, node.args, strict=True)} for node in called]
            if any(roles != given[0] for roles in given):
                raise InputError(
                    f"{where}: calls of {part.id} pass state, measurement or parameters in different positions; use "
                    "the same positions in every call"
                )
            roles = {name: role for name, role in given[0].items() if role is not None}
            calls[part.id] = _read(value, roles, known, above)
        elif isinstance(value, bool | int | float):
            constants[part.id] = value
        elif value is not math and not (part.id in BUILTINS and value is getattr(builtins, part.id)):
            raise InputError(
                f"{where}: {part.id!r} is neither a number nor a function that step may call; use numbers, your own "
                "functions, and those of math"
            )
    return constants, calls


def _is_name(node: ast.AST, name: str) -> bool:
    return isinstance(node, ast.Name) and node.id == name


@dataclass(frozen=True)
class Layout:
    """Positions of a controller's numbers in two arrays of the compiled simulation: state `_x`, parameters `_c`.

    `_x` contains the scalars of the state, then its arrays. `_c` contains in this order: `first` numbers of the
    simulation; the scalar parameters; start index and length of each array parameter and each array of the state; the
    array parameters.
    """

    state: tuple[str, ...]
    state_arrays: tuple[str, ...]
    parameters: tuple[str, ...]
    parameter_arrays: tuple[str, ...]
    first: int

    def row(self, values: Mapping[str, Any], state_sizes: Sequence[int]) -> tuple[float, ...]:
        """Return the numbers in `_c` from index `first` on; `state_sizes` are the lengths of the state's arrays."""
        arrays = [tuple(map(float, values[name])) for name in self.parameter_arrays]
        index = self.first + len(self.parameters) + 2 * (len(arrays) + len(state_sizes))
        header: list[float] = []
        for array in arrays:
            header += [float(index), float(len(array))]
            index += len(array)
        index = len(self.state)
        for size in state_sizes:
            header += [float(index), float(size)]
            index += size
        scalars = (float(values[name]) for name in self.parameters)
        return (*scalars, *header, *(number for array in arrays for number in array))

    def scalar(self, role: str, name: str) -> str | None:
        """Return the text of a scalar field, for example "_x[2]"; None if the field is not a scalar."""
        if role == MEASUREMENT:
            return MEASURED.get(name)
        names, array, first = (self.state, "_x", 0) if role == STATE else (self.parameters, "_c", self.first)
        return f"{array}[{first + names.index(name)}]" if name in names else None

    def array_header(self, role: str, name: str) -> int | None:
        """Return the index i for an array field: `_c[i]` is the position of its first number, `_c[i + 1]` its length.

        None if the field is not an array.
        """
        if role == MEASUREMENT:
            return None
        names = (*self.parameter_arrays, *self.state_arrays)
        own = self.state_arrays if role == STATE else self.parameter_arrays
        if name not in own:
            return None
        index = names.index(name) if role == PARAMETERS else len(self.parameter_arrays) + own.index(name)
        return self.first + len(self.parameters) + 2 * index


ARGUMENTS = ("_x", *MEASURED.values(), "_c", "_table")


def kernel_text(step: Function, layout: Layout, command: str = "command") -> str:
    """Return the translation of `step` and of the functions that it calls, as text for the compiled simulation.

    The last function of the text has the name `command` and calls `step`. It has the arguments `ARGUMENTS`, then the
    arguments of `step` other than state, measurement and parameters.
    """
    functions = [function for function in step.all().values() if not function.is_outside]
    printed = [f"@compiled\n{ast.unparse(_Printer(function, layout).printed())}\n" for function in functions]
    names = ", ".join((*ARGUMENTS, *(name for name in step.arguments if name not in step.roles)))
    last = f"@compiled\ndef {command}({names}):\n    return {_prefixed(step.name)}({names})\n"
    return "\n\n".join([*printed, last])


def _prefixed(name: str) -> str:
    return f"controller_{name}"


class _Printer(ast.NodeTransformer):
    """Replaces the fields of records in a function by elements of the arrays of the compiled simulation."""

    def __init__(self, function: Function, layout: Layout) -> None:
        self._function, self._layout = function, layout
        self._arrays: dict[str, int] = {}

    def printed(self) -> ast.FunctionDef:
        import copy

        node = copy.deepcopy(self._function.node)
        body = [self.visit(statement) for statement in node.body]
        others = [ast.arg(name) for name in self._function.arguments if name not in self._function.roles]
        arguments = ast.arguments([], [*map(ast.arg, ARGUMENTS), *others], None, [], [], None, [])
        definition = ast.FunctionDef(_prefixed(self._function.name), arguments, [*self._prologue(), *body], [], None)
        return ast.fix_missing_locations(definition)

    def _prologue(self) -> Iterable[ast.stmt]:
        for name, header in self._arrays.items():
            yield from ast.parse(f"_at_{name} = int(_c[{header}])\n_len_{name} = int(_c[{header + 1}])").body

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        return node

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self._function.constants and isinstance(node.ctx, ast.Load):
            value = self._function.constants[node.id]
            text = repr(value) if math.isfinite(value) else f"{'-' * (value < 0)}math.{abs(value)!s}"
            return ast.parse(text, mode="eval").body
        return node

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        role = self._function.role(node.value)
        if role is None:
            return node  # of the module math
        text = self._layout.scalar(role, node.attr)
        if text is None:
            raise self._unknown(role, node)
        scalar = ast.parse(text, mode="eval").body
        if isinstance(scalar, ast.Subscript | ast.Name):
            scalar.ctx = node.ctx
        return scalar

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        header, name, array = self._array(node.value)
        self._arrays[name] = header
        whole = ast.Call(ast.Name("int", ast.Load()), [self.visit(node.slice)], [])  # a parameter is a float
        index = ast.BinOp(ast.Name(f"_at_{name}", ast.Load()), ast.Add(), whole)
        return ast.Subscript(ast.Name(array, ast.Load()), index, node.ctx)

    def _array(self, node: ast.expr) -> tuple[int, str, str]:
        if not isinstance(node, ast.Attribute) or (role := self._function.role(node.value)) is None:
            raise InputError(
                f"{self._function.name}: {ast.unparse(node)} is not an array; give an array of state or parameters"
            )
        header = self._layout.array_header(role, node.attr)
        if header is None:
            raise self._unknown(role, node)
        return header, f"{role}_{node.attr}", "_x" if role == STATE else "_c"

    def _unknown(self, role: str, node: ast.Attribute) -> InputError:
        layout = self._layout
        names = {
            STATE: (*layout.state, *layout.state_arrays),
            PARAMETERS: (*layout.parameters, *layout.parameter_arrays),
            MEASUREMENT: tuple(MEASURED),
        }[role]
        return InputError(f"{self._function.name}: {role} has no {node.attr!r}; it has {', '.join(names) or 'nothing'}")

    def visit_Call(self, node: ast.Call) -> ast.expr:
        if isinstance(node.func, ast.Name) and node.func.id == "len":
            header, name, _ = self._array(node.args[0])
            self._arrays[name] = header
            return ast.Name(f"_len_{name}", ast.Load())
        called = self._function.calls.get(node.func.id) if isinstance(node.func, ast.Name) else None
        others = [self.visit(each) for each in node.args if self._function.role(each) is None]
        if isinstance(node.func, ast.Name) and node.func.id == "range":
            others = [ast.Call(ast.Name("int", ast.Load()), [each], []) for each in others]  # a parameter is a float
        if called is None:
            return ast.Call(node.func, others, [])
        name = called.name if called.is_outside else _prefixed(called.name)
        return ast.Call(ast.Name(name, ast.Load()), [*(ast.Name(each, ast.Load()) for each in ARGUMENTS), *others], [])

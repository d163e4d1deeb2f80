"""The seeking controller as a C99 program, translated from the text that runs."""

from __future__ import annotations

import ast
import textwrap
from pathlib import Path
from types import SimpleNamespace

from railslip_ctrl import __version__
from railslip_ctrl.core.templates import environment

from . import seeking_step
from .controllers import write_text
from .seeking import SeekingControl

_WIDTH = 100
_CALLS = {"min": "lesser", "max": "larger", "float": "(double)", "int": "(int)"}
_OPERATORS: dict[type[ast.AST], str] = {
    **{ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Mod: "%"},
    **{ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="},
    **{ast.And: "&&", ast.Or: "||", ast.Not: "!", ast.USub: "-"},
}


def c_program(control: SeekingControl, radius: float) -> str:
    """The controller with its numbers as one C99 translation unit: no allocation, a step of bounded time.

    Parameters
    ----------
    control : SeekingControl
    radius : float
        Wheel radius r, m.

    Returns
    -------
    str
        `railslip_seeking_state`, `railslip_seeking_init(state)` and `railslip_seeking_step(state, v, omega, applied)`,
        to be called every period of `control`: train speed, m/s, wheel speed, rad/s, and the torque that the brake took
        from the step before, N*m (0 in the first), to torque, N*m.
    """
    known = vars(seeking_step)
    names = [name for name, at in known.items() if name.isupper() and type(at) is int and name != "RADIUS"]
    gains, states = names[: names.index("SAMPLES")], names[names.index("SAMPLES") :]
    own = control.row(SimpleNamespace(period=control.period))  # type: ignore[arg-type]  # it reads no more of it
    nodes = ast.parse(Path(seeking_step.__file__).read_text("utf-8")).body
    return str(
        environment("railslip_ctrl.simulation")
        .get_template("seeking.c.jinja")
        .render(
            version=__version__,
            period=control.period,
            row=[repr(number) for number in (0.0, radius, *own)],  # the reference it is compared with is not used
            gains=["REFERENCE", "RADIUS", *gains],
            states=states,
            size=len(control.states),
            numbers=[(name.lstrip("_"), at) for name, at in known.items() if type(at) is float],
            functions=[_function(node) for node in nodes if isinstance(node, ast.FunctionDef)],
        )
    )


def save_c_program(control: SeekingControl, radius: float, path: str | Path) -> None:
    """Write `c_program`. InputError where it cannot be written."""
    write_text(path, c_program(control, radius))


def _function(node: ast.FunctionDef) -> str:
    """A function in C: x and c are arrays, what is counted is an int, all else a double."""
    used = {one.id for one in ast.walk(node) if isinstance(one, ast.Name)}
    names = [argument.arg for argument in node.args.args if argument.arg in used]
    arguments = ", ".join({"x": "double *x", "c": "const double *c"}.get(name, f"double {name}") for name in names)
    body = [one for one in node.body if not (isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant))]
    counted, locals_ = _locals(node, names)
    declared = [f"{kind} {', '.join(found)};" for kind, found in (("int", counted), ("double", locals_)) if found]
    gives = any(isinstance(one, ast.Return) and one.value is not None for one in ast.walk(node))
    text = ast.get_docstring(node) or ""
    comment = textwrap.wrap(f"/* {' '.join(text.split())} */", _WIDTH, subsequent_indent="   ")
    head = f"static {'double' if gives else 'void'} {node.name}({arguments})"
    return "\n".join([*comment, head, "{", *_block(declared), *_block(_statements(body)), "}"])


def _locals(node: ast.FunctionDef, arguments: list[str]) -> tuple[list[str], list[str]]:
    """Names that a function assigns: those counted or true, and the others; in the order of their appearance."""
    counted: dict[str, None] = {}
    others: dict[str, None] = {}
    for one in ast.walk(node):
        if isinstance(one, ast.For) and isinstance(one.target, ast.Name):
            counted[one.target.id] = None
        if not isinstance(one, ast.Assign):
            continue
        for target, value in _pairs(one):
            if isinstance(target, ast.Name) and target.id not in arguments:
                (counted if _is_whole(value, counted) else others)[target.id] = None
    return [name for name in counted if name not in others], list(others)


def _is_whole(value: ast.expr, counted: dict[str, None]) -> bool:
    """Whether an expression is a whole number or a truth."""
    if isinstance(value, ast.Call):
        return isinstance(value.func, ast.Name) and value.func.id == "int"
    if isinstance(value, ast.Constant):
        return isinstance(value.value, int)
    if isinstance(value, ast.Name):
        return value.id in counted or type(getattr(seeking_step, value.id, None)) is int
    if isinstance(value, ast.BinOp):
        return _is_whole(value.left, counted) and _is_whole(value.right, counted)
    return isinstance(value, ast.Compare | ast.BoolOp)


def _pairs(node: ast.Assign) -> list[tuple[ast.expr, ast.expr]]:
    """Targets and values of an assignment, one by one."""
    (target,) = node.targets
    if isinstance(target, ast.Tuple):
        assert isinstance(node.value, ast.Tuple)
        return list(zip(target.elts, node.value.elts, strict=True))
    return [(target, node.value)]


def _block(lines: list[str]) -> list[str]:
    return [
        part
        for line in lines
        for part in textwrap.wrap("    " + line, _WIDTH, subsequent_indent=" " * (len(line) - len(line.lstrip()) + 8))
    ]


def _statements(nodes: list[ast.stmt]) -> list[str]:
    return [line for node in nodes for line in _statement(node)]


def _statement(node: ast.stmt) -> list[str]:
    match node:
        case ast.Assign():  # of several, no value reads a target beside it
            return [f"{_text(target)} = {_bare(value)};" for target, value in _pairs(node)]
        case ast.AugAssign():
            return [f"{_text(node.target)} {_OPERATORS[type(node.op)]}= {_bare(node.value)};"]
        case ast.Return():
            return ["return;" if node.value is None else f"return {_bare(node.value)};"]
        case ast.If():
            other = ["} else {", *_block(_statements(node.orelse))] if node.orelse else []
            return [f"if ({_bare(node.test)}) {{", *_block(_statements(node.body)), *other, "}"]
        case ast.While():
            return [f"while ({_bare(node.test)}) {{", *_block(_statements(node.body)), "}"]
        case ast.For(target=ast.Name(id=name), iter=ast.Call(args=[end])):
            return [f"for ({name} = 0; {name} < {_text(end)}; {name}++) {{", *_block(_statements(node.body)), "}"]
        case ast.Expr():
            return [f"{_text(node.value)};"]
    raise NotImplementedError(ast.dump(node))


def _text(node: ast.expr) -> str:
    """An expression in C, each operation in brackets."""
    match node:
        case ast.Constant():
            return repr(node.value)
        case ast.Name():
            return node.id.lstrip("_")
        case ast.Subscript():
            return f"{_text(node.value)}[{_bare(node.slice)}]"
        case ast.Attribute():
            return node.attr  # of math
        case ast.BinOp(op=ast.Pow(), right=ast.Constant(value=2)):
            return f"({_text(node.left)} * {_text(node.left)})"
        case ast.BinOp():
            return f"({_text(node.left)} {_OPERATORS[type(node.op)]} {_text(node.right)})"
        case ast.UnaryOp():
            return f"{_OPERATORS[type(node.op)]}{_text(node.operand)}"
        case ast.BoolOp():
            return f"({f' {_OPERATORS[type(node.op)]} '.join(_text(value) for value in node.values)})"
        case ast.Compare():
            sides = [node.left, *node.comparators]
            pairs = zip(sides[:-1], node.ops, sides[1:], strict=True)
            told = [f"({_text(a)} {_OPERATORS[type(op)]} {_text(b)})" for a, op, b in pairs]
            return told[0] if len(told) == 1 else f"({' && '.join(told)})"
        case ast.IfExp():
            return f"({_text(node.test)} ? {_text(node.body)} : {_text(node.orelse)})"
        case ast.Call():
            name = _text(node.func)
            return f"{_CALLS.get(name, name)}({', '.join(_bare(argument) for argument in node.args)})"
    raise NotImplementedError(ast.dump(node))


def _bare(node: ast.expr) -> str:
    """An expression without the brackets around it."""
    text = _text(node)
    return text[1:-1] if isinstance(node, ast.BinOp | ast.BoolOp | ast.Compare | ast.IfExp) else text
